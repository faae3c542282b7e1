import gc
import weakref
from dataclasses import replace

import numpy as np
import psutil
import pytest
from naraha.diagrams.robots import ROBOTS
from naraha.diagrams.scenario import dump_scenario, load_scenario
from naraha.diagrams.seeds import sensor_seed
from naraha.diagrams.sensor_head import HeadConfig
from naraha.diagrams.station import X_B, RobotConfig, StationConfig, make_station
from naraha.diagrams.survey import SurveyScenario, make_survey
from naraha.diagrams.wiring import connect
from naraha.systems.drive import CrawlerDriver, DifferentialDriver, TiltConfig
from naraha.systems.errors import ConfigError, InputError, WorldError
from naraha.systems.sensing import LidarConfig
from naraha.systems.slam import Odometry6Dof
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from tests.examples import leaves


def run_station(config, seed, seconds, twist=(0.3, 0.0)):
    station = make_station(config, seed=seed)
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    station.GetInputPort("twist_command").FixValue(context, np.array(twist))
    if station.HasInputPort("flipper_preset"):
        station.GetInputPort("flipper_preset").FixValue(context, Value("auto"))
    simulator.AdvanceTo(seconds)
    return {name: station.GetOutputPort(name).Eval(context) for name in ("scan_S", "rpy", "X_BS", "cheat.X_WB")}


def hall(model="crawler", **changes):
    start = [-8.0, -5.0, ROBOTS[model].base_height]
    return StationConfig(robot=RobotConfig(model=model, start_xyz=start, **changes))


def test_the_robot_drives_and_scans_the_hall():
    outputs = run_station(hall(), 0, 2.05)
    scan = outputs["scan_S"]
    assert scan.index == 19
    assert scan.end_time == pytest.approx(2.0)
    assert scan.start_time == pytest.approx(1.9)
    ranges = np.linalg.norm(scan.p_SP, axis=1)
    assert len(ranges) > 15000
    assert ranges.min() > 0.4
    assert ranges.max() < 25
    assert outputs["cheat.X_WB"].translation()[0] == pytest.approx(-8 + 0.3 * 2.05, abs=0.15)


def test_a_seed_repeats_the_scan_and_another_changes_it():
    first, again, other = (run_station(hall(), seed, 0.25)["scan_S"].p_SP for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert first.shape != other.shape or np.abs(first - other).max() > 1e-4


def test_points_lie_on_the_walls_of_the_hall():
    outputs = run_station(replace(hall(), lidar=LidarConfig(mirror=False)), 0, 0.35, twist=(0.0, 0.0))
    X_WS = outputs["cheat.X_WB"] @ X_B(make_station(hall(), seed=0), "lidar")
    p_WP = (X_WS.rotation().matrix() @ outputs["scan_S"].p_SP.T).T + X_WS.translation()
    on_west_wall = np.abs(p_WP[:, 0] + 10) < 0.05
    assert on_west_wall.sum() > 300
    assert p_WP[:, 2].min() > -0.1
    assert np.abs(p_WP[:, 0]).max() < 10.1
    assert np.abs(p_WP[:, 1]).max() < 7.1


@pytest.mark.parametrize("model", sorted(ROBOTS))
def test_every_shipped_robot_makes_a_station_and_stands_where_it_starts(model):
    config = hall(model)
    outputs = run_station(config, 0, 0.15, twist=(0.0, 0.0))
    assert outputs["scan_S"].index == 0
    assert outputs["cheat.X_WB"].IsNearlyEqualTo(config.robot.X_WB(), 2e-3)


@pytest.mark.parametrize("model", sorted(ROBOTS))
def test_a_station_has_the_ports_of_its_robot(model):
    station = make_station(hall(model), seed=0)
    inputs = {station.get_input_port(i).get_name() for i in range(station.num_input_ports())}
    outputs = {station.get_output_port(i).get_name() for i in range(station.num_output_ports())}
    everywhere = {"track_displacements", "track_speeds", "rpy", "gyro", "accelerometer", "scan_S", "X_BS", "cheat.X_WB"}
    if model.startswith("crawler"):
        assert inputs == {"twist_command", "flipper_preset"}
        assert outputs == everywhere | {"flipper_angles", "active_preset"}
    else:
        assert inputs == {"twist_command"}
        assert outputs == everywhere | (set() if model == "lux_robot" else {"tilt_angle"})


@pytest.mark.parametrize("model", ["crawler", "pioneer", "amphibious"])
def test_odometry_closes_a_square(model):
    """Four legs of 1 m with a turn of 90° after each, by time alone."""
    builder = DiagramBuilder()
    config = hall(model)
    config.lidar = None
    station = builder.AddSystem(make_station(config, seed=0))
    odometry = builder.AddNamedSystem("odometry", Odometry6Dof(X_OB0=config.robot.X_WB()))
    for name in ("track_displacements", "rpy"):
        connect(builder, station, name, odometry)
    builder.ExportInput(station.GetInputPort("twist_command"), "twist_command")
    if station.HasInputPort("flipper_preset"):
        builder.ExportInput(station.GetInputPort("flipper_preset"), "flipper_preset")
    builder.ExportOutput(odometry.GetOutputPort("X_OB"), "X_OB")
    builder.ExportOutput(station.GetOutputPort("cheat.X_WB"), "X_WB")
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    if diagram.HasInputPort("flipper_preset"):
        diagram.GetInputPort("flipper_preset").FixValue(context, Value("auto"))
    for _ in range(4):
        for twist, seconds in (((0.25, 0.0), 4.0), ((0.0, 0.4), np.pi / 2 / 0.4)):
            diagram.GetInputPort("twist_command").FixValue(context, np.array(twist))
            simulator.AdvanceTo(context.get_time() + seconds)
    simulator.AdvanceTo(context.get_time() + 0.5)
    X_OB, X_WB = (diagram.GetOutputPort(name).Eval(context) for name in ("X_OB", "X_WB"))
    assert np.linalg.norm(X_OB.translation() - X_WB.translation()) < 0.08  # 2 % of the way
    assert np.linalg.norm(X_WB.translation() - config.robot.X_WB().translation()) < 0.4  # it came round


def tilted(model="pioneer", **changes):
    config = hall(model)
    config.lidar = LidarConfig(pattern="utm30lx", mirror=False, **changes)
    config.tilt = TiltConfig(lowest_deg=10.0, highest_deg=50.0, period=1.0)
    return config


@pytest.mark.parametrize("model", ["pioneer", "amphibious"])
@pytest.mark.parametrize("end", [0.3, 0.51, 0.77])
def test_a_tilting_scan_lies_on_the_floor_with_the_measured_pose_of_its_end(model, end):
    """Scans across the reversal of the sweep too; both are read between two scans."""
    outputs = run_station(tilted(model, range_noise=0.0), 0, end, twist=(0.0, 0.0))
    scan = outputs["scan_S"]
    X_WS = outputs["cheat.X_WB"] @ outputs["X_BS"]
    ahead = np.abs(np.arctan2(scan.p_SP[:, 1], scan.p_SP[:, 0])) < 0.3
    p_WP = X_WS.multiply(scan.p_SP[ahead].astype(float).T).T
    assert len(p_WP) > 100
    # The unit turns by 80°/s, 1.5° in the part of a scan that lies ahead: at 1.5 m, up to 40 mm.
    assert np.abs(p_WP[:, 2]).max() < 0.06


def test_the_lidar_pose_of_a_fixed_lidar_is_that_of_the_model():
    outputs = run_station(hall(), 0, 0.15)
    assert outputs["X_BS"].IsNearlyEqualTo(X_B(make_station(hall(), seed=0), "lidar"), 1e-12)


def test_the_robot_does_not_see_itself():
    """Nothing within the reach of the robot's own body, while the beams sweep over its deck."""
    for time in (0.3, 0.5, 0.7):
        scan = run_station(tilted("amphibious"), 0, time, twist=(0.0, 0.0))["scan_S"]
        assert np.linalg.norm(scan.p_SP, axis=1).min() > 0.5


def test_a_tilt_on_a_robot_without_one_is_refused():
    config = hall()
    config.tilt = TiltConfig()
    with pytest.raises(ConfigError, match="tilt: the robot has no tilt unit"):
        make_station(config, seed=0)


def test_a_driver_of_another_robot_is_refused():
    config = hall("pioneer", driver=CrawlerDriver())
    with pytest.raises(ConfigError, match=r"robot\.driver: does not fit 'pioneer'.*DifferentialDriver"):
        make_station(config, seed=0)


def test_a_start_inside_the_floor_is_refused():
    config = hall("amphibious")
    config.robot.start_xyz[2] = 0.08
    with pytest.raises(WorldError, match=r"robot\.start_xyz: the robot starts 40 mm inside.*0\.12 m over its floor"):
        make_station(config, seed=0)


def test_a_scenario_that_only_names_the_robot_gets_its_driver_and_its_height(tmp_path):
    path = tmp_path / "robot.yaml"
    path.write_text("robot: {model: pioneer, driver: {max_speed: 0.4}}")
    scenario = load_scenario(SurveyScenario, str(path), ["robot.driver.wheel_radius=0.1"])
    assert scenario.robot.driver == DifferentialDriver(max_speed=0.4, wheel_radius=0.1)
    assert scenario.robot == RobotConfig(model="pioneer", driver=scenario.robot.driver)
    path.write_text(dump_scenario(scenario))
    assert load_scenario(SurveyScenario, str(path)).robot == scenario.robot


@pytest.mark.parametrize(
    ("text", "settings", "message"),
    [
        (
            "robot: {model: pioneer, driver: {flipper_upper: 1}}",
            (),
            r"robot\.yaml: robot\.driver\.flipper_upper: unknown",
        ),
        ("{}", ("robot.driver.wheel_radius=1",), r"--set robot\.driver\.wheel_radius=1: .*unknown key"),
        ("robot: {model: pioneer}", ("robot.driver.gauge=-1",), r"robot\.driver\.gauge: out of range"),
    ],
)
def test_keys_of_another_robots_driver_are_refused(tmp_path, text, settings, message):
    path = tmp_path / "robot.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        load_scenario(SurveyScenario, str(path), settings)


def test_parts_get_seeds_of_their_own():
    seeds = {sensor_seed(seed, name) for seed in range(10) for name in ("imu", "lidar")}
    assert len(seeds) == 20
    assert sensor_seed(1, "imu") == sensor_seed(1, "imu")


def test_a_survey_that_was_dropped_is_freed():
    """Builds and drops the survey 20 times: no system of ours stays, and memory does not grow."""
    scenario = load_scenario(SurveyScenario, "stair_hall")

    def build() -> list[weakref.ref]:
        diagram = make_survey(scenario)
        Simulator(diagram).Initialize()
        ours = [leaf for leaf in leaves(diagram) if type(leaf).__module__.startswith("naraha.")]
        assert len(ours) > 10
        return [weakref.ref(leaf) for leaf in ours]

    references = [ref for _ in range(5) for ref in build()]
    gc.collect()
    before = psutil.Process().memory_info().rss
    references += [ref for _ in range(15) for ref in build()]
    gc.collect()
    alive = [type(ref()).__name__ for ref in references if ref() is not None]
    assert alive == []
    assert psutil.Process().memory_info().rss - before < 60e6


def head_outputs(seconds, **changes):
    """Outputs of a station with a head that stands in the hall and turns its pan-tilt unit to the left and down."""
    config = hall(**changes)
    config.head = HeadConfig()
    station = make_station(config, seed=0)
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    station.GetInputPort("twist_command").FixValue(context, np.zeros(2))
    station.GetInputPort("flipper_preset").FixValue(context, Value("auto"))
    station.GetInputPort("pan_tilt_command").FixValue(context, np.array([0.2, 0.1]))
    simulator.AdvanceTo(seconds)
    return station, lambda name: station.GetOutputPort(name).Eval(context)


def test_the_head_sees_the_floor_where_it_is():
    station, output = head_outputs(1.05)
    depth = output("depth_image").data[:, :, 0]
    camera = HeadConfig().depth_camera.model()
    X_WD = output("cheat.X_WB") @ X_B(station, "depth_camera")
    usable = (depth > 0) & np.isfinite(depth)
    p_WP = X_WD.multiply(camera.unproject(depth)[usable.ravel()].T.astype(float)).T
    assert usable.mean() > 0.5
    assert np.mean(np.abs(p_WP[:, 2]) < 0.02) > 0.2  # the floor
    assert p_WP[:, 2].min() > -0.2
    assert p_WP[:, 0].min() > -8 + 0.45  # ahead
    assert output("depth_image_time")[0] == pytest.approx(1.0, abs=0.1)


def test_the_head_gives_what_its_cameras_and_counter_measure():
    _, output = head_outputs(1.05)
    np.testing.assert_allclose(output("pan_tilt_angles"), [0.2, 0.1], atol=2e-3)
    np.testing.assert_allclose(output("cheat.pan_tilt_angles"), [0.2, 0.1], atol=1e-9)
    assert output("nir_image").data.max() > 50
    assert output("nir_exposure")[0] > 0
    temperature = output("temperature_image")
    assert temperature.shape == (60, 80)
    assert np.nanmedian(temperature) == pytest.approx(20, abs=2)
    reading = output("dose_reading")
    assert reading.index == 1
    assert reading.dose_rate == pytest.approx(output("cheat.dose_rate")[0], abs=5 * reading.sigma)
