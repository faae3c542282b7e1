import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.drive import FLIPPERS, FlipperDriver, FlipperDriverConfig
from naraha.systems.drive.flipper_driver import approach_angles
from naraha.systems.errors import ConfigError
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator

from tests.drive.rig import robot_urdf

ANGLES = np.array([0.1, -0.2, 0.3, -0.4])


@pytest.fixture(scope="module")
def plant():
    plant = MultibodyPlant(0.004)
    # A second model in front of the crawler, so that indices of the plant are not those of the model.
    plant.AddRigidBody("other", plant.AddModelInstance("other"))
    Parser(plant).AddModelsFromString(robot_urdf("crawler"), "urdf")
    plant.Finalize()
    return plant


@pytest.fixture(scope="module")
def crawler(plant):
    return plant.GetModelInstanceByName("crawler")


@pytest.fixture(scope="module")
def plant_state(plant, crawler):
    """The model's state with ANGLES set joint by joint, by name."""
    context = plant.CreateDefaultContext()
    for name, angle in zip(FLIPPERS, ANGLES, strict=True):
        plant.GetJointByName(f"{name}_flipper_joint").set_angle(context, angle)
    return plant.get_state_output_port(crawler).Eval(context)


def simulate(system, state, command=None):
    simulator = Simulator(system)
    system.GetInputPort("state").FixValue(simulator.get_mutable_context(), state)
    if command is not None:
        system.GetInputPort("flipper_command").FixValue(simulator.get_mutable_context(), command)
    return simulator


def desired(system, simulator, plant, crawler):
    """Desired angles and speeds by flipper, read in the order of the plant's actuators."""
    value = system.GetOutputPort("desired_state").Eval(simulator.get_context()).reshape(2, 4)
    actuators = [plant.get_joint_actuator(i).joint().name() for i in plant.GetJointActuatorIndices(crawler)]
    order = [actuators.index(f"{name}_flipper_joint") for name in FLIPPERS]
    return value[:, order]


def test_measured_angles_come_in_the_order_of_flippers(plant, crawler, plant_state):
    system = FlipperDriver(FlipperDriverConfig(), plant, crawler)
    simulator = simulate(system, plant_state)
    np.testing.assert_allclose(system.GetOutputPort("flipper_angles").Eval(simulator.get_context()), ANGLES)


def test_without_a_command_the_flippers_hold_where_they_are_at_the_start(plant, crawler, plant_state):
    system = FlipperDriver(FlipperDriverConfig(), plant, crawler)
    simulator = simulate(system, plant_state)
    simulator.AdvanceTo(1.0)
    np.testing.assert_allclose(desired(system, simulator, plant, crawler), [ANGLES, np.zeros(4)])


def test_the_setpoint_moves_with_the_flipper_speed_and_then_rests(plant, crawler, plant_state):
    change = np.array([0.4, -0.4, 0.02, 0.0])
    system = FlipperDriver(FlipperDriverConfig(period=0.02, flipper_max_speed=0.5), plant, crawler)
    simulator = simulate(system, plant_state, ANGLES + change)
    simulator.AdvanceTo(0.19)  # samples at 0, 0.02 … 0.18
    angles, speeds = desired(system, simulator, plant, crawler)
    np.testing.assert_allclose(angles, ANGLES + np.clip(change, -0.1, 0.1), atol=1e-12)
    np.testing.assert_allclose(speeds, [0.5, -0.5, 0.0, 0.0], atol=1e-9)
    simulator.AdvanceTo(2.0)
    angles, speeds = desired(system, simulator, plant, crawler)
    np.testing.assert_allclose(angles, ANGLES + change, atol=1e-12)
    np.testing.assert_allclose(speeds, 0, atol=1e-9)


def test_commands_are_clipped_and_nan_holds_that_flipper(plant, crawler, plant_state):
    config = FlipperDriverConfig(flipper_lower=-1.0, flipper_upper=1.2)
    system = FlipperDriver(config, plant, crawler)
    simulator = simulate(system, plant_state, np.array([9.0, -9.0, np.nan, 0.5]))
    simulator.AdvanceTo(4.0)
    np.testing.assert_allclose(desired(system, simulator, plant, crawler)[0], [1.2, -1.0, ANGLES[2], 0.5])


@given(previous=st.floats(-2, 2), command=st.floats(-9, 9), change=st.floats(1e-3, 1.0))
def test_an_approach_never_overshoots_nor_exceeds_its_step(previous, command, change):
    (reached,) = approach_angles(np.array([previous]), np.array([command]), -1.5, 1.5, change)
    target = np.clip(command, -1.5, 1.5)
    assert abs(reached - previous) <= change + 1e-12
    assert abs(target - reached) == pytest.approx(max(0.0, abs(target - previous) - change), abs=1e-12)


def test_a_model_without_flippers_is_refused(plant):
    with pytest.raises(ConfigError, match=r"other.*front_left_flipper_joint"):
        FlipperDriver(FlipperDriverConfig(), plant, plant.GetModelInstanceByName("other"))


def test_actuators_without_gains_are_refused():
    plant = MultibodyPlant(0.004)
    urdf = robot_urdf("crawler").replace("drake:controller_gains", "drake:no_gains")
    (crawler,) = Parser(plant).AddModelsFromString(urdf, "urdf")
    plant.Finalize()
    with pytest.raises(ConfigError, match="controller_gains"):
        FlipperDriver(FlipperDriverConfig(), plant, crawler)


def test_limits_that_cross_are_refused(plant, crawler):
    with pytest.raises(ConfigError, match=r"flipper_lower.*<= 0 rad"):
        FlipperDriver(FlipperDriverConfig(flipper_lower=0.5, flipper_upper=0.0), plant, crawler)
