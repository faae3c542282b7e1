import gc
import weakref
from dataclasses import replace

import numpy as np
import psutil
import pytest
from naraha.diagrams.scenario import load_scenario
from naraha.diagrams.seeds import sensor_seed
from naraha.diagrams.sensor_head import HeadConfig
from naraha.diagrams.station import X_B, RobotConfig, StationConfig, make_station, shipped_robots
from naraha.diagrams.survey import SurveyScenario, make_survey
from naraha.systems.sensing import LidarConfig
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator

from tests.examples import leaves


def run_station(config, seed, seconds, twist=(0.3, 0.0)):
    station = make_station(config, seed=seed)
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    station.GetInputPort("twist_command").FixValue(context, np.array(twist))
    station.GetInputPort("flipper_preset").FixValue(context, Value("auto"))
    simulator.AdvanceTo(seconds)
    return {name: station.GetOutputPort(name).Eval(context) for name in ("scan_S", "rpy", "cheat.X_WB")}


def hall(**changes):
    return StationConfig(robot=RobotConfig(start_xyz=[-8.0, -5.0, 0.08], **changes))


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


@pytest.mark.parametrize("model", sorted(shipped_robots()))
def test_every_shipped_robot_makes_a_station(model):
    assert run_station(hall(model=model), 0, 0.15)["scan_S"].index == 0


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
