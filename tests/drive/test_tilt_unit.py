import numpy as np
import pytest
from naraha.models import MODELS_DIR
from naraha.systems.drive import TiltConfig, TiltEncoder, TiltSweep
from naraha.systems.drive.setpoints import add_setpoints, find_actuators
from naraha.systems.drive.tilt_unit import sweep
from naraha.systems.errors import ConfigError, PortError
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

profiles = pytest.mark.parametrize("profile", ["triangle", "sine"])


@pytest.fixture(scope="module", params=["pioneer", "amphibious"])
def robot(request):
    plant = MultibodyPlant(0.004)
    Parser(plant).AddModels(str(MODELS_DIR / request.param / f"{request.param}.urdf"))
    plant.Finalize()
    return plant, plant.GetModelInstanceByName(request.param)


@profiles
def test_a_sweep_goes_from_end_to_end_and_back(profile):
    config = TiltConfig(lowest_deg=-10, highest_deg=40, period=2.0, profile=profile)
    angles = np.array([sweep(t, config)[0] for t in np.linspace(0, 4, 401)])
    np.testing.assert_allclose(angles[[0, 50, 100, 150, 200]], np.deg2rad([-10, 15, 40, 15, -10]), atol=1e-12)
    assert np.rad2deg(angles.max()) == pytest.approx(40)
    assert np.rad2deg(angles.min()) == pytest.approx(-10)
    np.testing.assert_allclose(angles[:201], angles[200:], atol=1e-9)


@profiles
def test_the_rate_is_the_derivative_of_the_angle(profile):
    config = TiltConfig(period=1.5, profile=profile)
    for t in np.linspace(0.01, 1.6, 30):
        step = 1e-6
        difference = (sweep(t + step, config)[0] - sweep(t - step, config)[0]) / (2 * step)
        assert sweep(t, config)[1] == pytest.approx(difference, abs=1e-5)


def test_equal_ends_stand_still():
    config = TiltConfig(lowest_deg=20, highest_deg=20)
    assert {sweep(t, config) for t in (0.0, 0.4, 1.3)} == {(np.deg2rad(20), 0.0)}


def test_a_sweep_the_wrong_way_round_is_refused():
    with pytest.raises(ConfigError, match=r"lowest_deg: is above highest_deg.*<= 10 deg"):
        TiltSweep(TiltConfig(lowest_deg=20, highest_deg=10))


def encoder_at(robot, angle, config=None, seed=0, seconds=0.0):
    plant, model = robot
    encoder = TiltEncoder(config or TiltConfig(), plant, model, period=0.025, seed=seed)
    simulator = Simulator(encoder)
    context = simulator.get_mutable_context()
    plant_context = plant.CreateDefaultContext()
    plant.GetJointByName("tilt_joint").set_angle(plant_context, angle)
    encoder.GetInputPort("state").FixValue(context, plant.GetPositionsAndVelocities(plant_context, model))
    simulator.Initialize()
    simulator.AdvanceTo(seconds)
    X_BS = plant.CalcRelativeTransform(
        plant_context, plant.GetFrameByName("base", model), plant.GetFrameByName("lidar", model)
    )
    return encoder.GetOutputPort("tilt_angle").Eval(context)[0], encoder.GetOutputPort("X_BS").Eval(context), X_BS


@pytest.mark.parametrize("angle", [-0.3, 0.0, 0.7])
def test_the_measured_pose_is_that_of_the_plant_but_for_the_encoder(robot, angle):
    measured, X_BS, X_BS_true = encoder_at(robot, angle)
    assert measured == pytest.approx(angle, abs=2e-3)
    assert X_BS.IsNearlyEqualTo(X_BS_true, 2e-3)
    exact, X_BS, X_BS_true = encoder_at(robot, angle, TiltConfig(noise=0.0, resolution=1e-9))
    assert exact == pytest.approx(angle, abs=1e-9)
    assert X_BS.IsNearlyEqualTo(X_BS_true, 1e-8)


def test_a_positive_angle_looks_down(robot):
    _, X_BS, _ = encoder_at(robot, 0.5)
    assert X_BS.rotation().matrix()[2, 0] == pytest.approx(-np.sin(0.5), abs=2e-3)


def test_readings_have_the_noise_and_the_steps_of_the_encoder(robot):
    config = TiltConfig(noise=1e-3, resolution=1e-4)
    readings = np.array([encoder_at(robot, 0.2, config, seed)[0] for seed in range(200)])
    assert np.std(readings) == pytest.approx(1e-3, rel=0.15)
    assert np.mean(readings) == pytest.approx(0.2, abs=3e-4)
    np.testing.assert_allclose(readings / 1e-4, np.rint(readings / 1e-4), atol=1e-6)
    assert encoder_at(robot, 0.2, config, 0, 0.1)[0] != readings[0]  # every reading has noise of its own


def test_an_encoder_without_its_robot_is_refused(robot):
    plant = MultibodyPlant(0.004)
    Parser(plant).AddModels(str(MODELS_DIR / "crawler" / "crawler.urdf"))
    plant.Finalize()
    with pytest.raises(ConfigError, match="no tilt unit, got 'crawler'"):
        TiltEncoder(TiltConfig(), plant, plant.GetModelInstanceByName("crawler"), period=0.025)
    encoder = TiltEncoder(TiltConfig(), *robot, period=0.025)
    with pytest.raises(PortError, match=r"TiltEncoder\.state"):
        Simulator(encoder).Initialize()


def test_setpoints_of_groups_reach_the_joints_that_they_are_for():
    plant = MultibodyPlant(0.004)
    Parser(plant).AddModels(str(MODELS_DIR / "pioneer" / "pioneer.urdf"))
    plant.Finalize()
    model = plant.GetModelInstanceByName("pioneer")
    builder = DiagramBuilder()
    groups = {"tilt": ["tilt_joint"], "wheels": ["right_wheel_joint", "left_wheel_joint"]}
    gather = add_setpoints(builder, plant, model, groups)
    builder.ExportInput(gather.get_input_port(0), "tilt")
    builder.ExportInput(gather.get_input_port(1), "wheels")
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    diagram.GetInputPort("tilt").FixValue(context, [1.0, 10.0])
    diagram.GetInputPort("wheels").FixValue(context, [2.0, 3.0, 20.0, 30.0])
    joints = [plant.get_joint_actuator(i).joint().name() for i in plant.GetJointActuatorIndices(model)]
    wanted = {"tilt_joint": (1, 10), "right_wheel_joint": (2, 20), "left_wheel_joint": (3, 30)}
    expected = [wanted[joint][k] for k in (0, 1) for joint in joints]
    np.testing.assert_array_equal(diagram.GetOutputPort("desired_state").Eval(context), expected)
    with pytest.raises(ConfigError, match="other actuated joints"):
        add_setpoints(DiagramBuilder(), plant, model, {"wheels": groups["wheels"]})
    with pytest.raises(ConfigError, match="no actuated joint of this name"):
        find_actuators(plant, model, ["caster_joint"])
