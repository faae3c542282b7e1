import gc
import weakref

import numpy as np
import pytest
from naraha.models.snake.snake_model import SnakeModel
from naraha.models.snake.urdf import snake_urdf
from naraha.systems.drive.snake_drive_kernels import drive_step
from naraha.systems.drive.snake_driver import ApplyDriverConfig, SnakeDriver
from naraha.systems.drive.snake_drives import SnakeDrives
from naraha.systems.errors import ConfigError
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from tests.drive.rig import robot_urdf
from tests.snake.robot import FLOOR, Snake

SHORT = SnakeModel(units=4)


@pytest.mark.parametrize(("target", "given"), [(0.05, 0.05), (0.4, 0.1), (-0.4, -0.1)])
def test_the_control_is_given_no_more_than_the_torque_allows(target, given):
    two = np.zeros(2)
    gains, limit = np.array([[10.0, 10.0], [0.0, 1.0]]), np.array([1.0, 1.0])
    ends = np.array([-1.0]), np.array([1.0])
    step = drive_step(
        np.zeros((4, 2)), two, two, np.array([target]), np.zeros(1), limit, gains, *ends, 0.005, 1e9, 10.0, 40.0
    )
    np.testing.assert_allclose(step[0], [target, 0.0])
    np.testing.assert_allclose(step[2], [given, 0.0])


@pytest.mark.parametrize("speed", [-0.1, 0.1, 0.4])
def test_it_rolls_with_the_commanded_speed(speed):
    snake = Snake(SHORT)
    snake.drive(speed)
    snake.run(2.0)
    start = snake.X_W("F0").translation()
    snake.run(1.0)
    np.testing.assert_allclose(snake.X_W("F0").translation() - start, [speed, 0.0, 0.0], atol=1e-3)
    np.testing.assert_allclose(snake.output("wheel_speeds"), speed / SHORT.wheel_radius, atol=1e-2)


def test_joints_follow_within_their_rate_and_range():
    snake = Snake(SHORT)
    snake.command(joint_command=[0, 0.5, 0, 9.0, 0, 0, 0])
    snake.run(0.2)
    assert snake.output("joint_angles")[1] == pytest.approx(1.5 * 0.2, abs=0.05)
    snake.run(2.0)
    np.testing.assert_allclose(snake.output("joint_angles")[[1, 3]], [0.5, SHORT.yaw_range], atol=0.02)


def test_what_is_not_a_number_holds_joints_and_stops_wheels():
    snake = Snake(SHORT)
    snake.command(joint_command=0.0, wheel_speed_command=2.0)
    snake.run(0.5)
    snake.command(joint_command=np.nan, wheel_speed_command=np.nan)
    snake.run(1.0)
    start = snake.X_W("F0").translation()
    snake.run(1.0)
    np.testing.assert_allclose(snake.X_W("F0").translation(), start, atol=1e-4)
    np.testing.assert_allclose(snake.output("joint_angles"), 0.0, atol=0.01)


def test_wheels_at_rest_do_not_creep_under_a_push():
    snake = Snake(SHORT)
    snake.run(0.5)
    start = snake.X_W("F0").translation()
    force = np.zeros(snake.plant.num_velocities())
    force[3] = 10.0  # [N] along the body, which its wheels at rest could hold with 48 N
    snake.plant.get_applied_generalized_force_input_port().FixValue(snake.plant_context, force)
    snake.run(3.0)
    assert np.linalg.norm(snake.X_W("F0").translation() - start) < 1e-3


WALL = (FLOOR, ((0.55, 0.0, 0.25), (1.0, 2.0, 0.5)))


@pytest.mark.parametrize("limit", [0.06, 0.14])
def test_a_blocked_wheel_pushes_with_its_limit_and_does_not_catch_up(limit):
    snake = Snake(SHORT, boxes=WALL, head=[0.03, 0.0, 0.05])
    snake.command(wheel_torque_limit=limit, wheel_speed_command=2.0)
    snake.run(2.0)
    np.testing.assert_allclose(snake.output("wheel_torques").max(), limit, rtol=0.1)
    snake.command(wheel_speed_command=0.0)
    snake.run(1.0)
    assert np.abs(snake.output("wheel_speeds")).max() < 1e-2


def test_a_joint_without_current_gives_way():
    snake = Snake(SHORT)
    snake.command(joint_command=[0, 0.6, 0, 0.6, 0, 0.6, 0], joint_torque_limit=[15, 0, 15, 15, 15, 15, 15])
    snake.run(2.0)
    angles = snake.output("joint_angles")
    assert angles[1] < 0.1
    np.testing.assert_allclose(angles[[3, 5]], 0.6, atol=0.05)
    assert abs(snake.output("joint_torques")[1]) < 0.2


def test_the_joint_that_holds_the_tail_up_has_the_torque():
    snake = Snake(SHORT)
    snake.command(joint_command=[0, 0, 0, 0, 0.3, 0, 0])
    snake.run(2.0)
    torques = snake.output("joint_torques")
    # Behind p2: half a unit, then a whole one with its wheels.
    weight = 9.81 * np.cos(0.3) * (0.355 * 0.045 + 0.355 * 0.135 + 0.24 * 0.18 + 0.355 * 0.225)
    assert torques[4] == pytest.approx(weight, rel=0.05)
    assert np.abs(np.delete(torques, 4)).max() < torques[4]


def test_a_model_that_is_no_snake_is_refused():
    plant = MultibodyPlant(0.005)
    Parser(plant).AddModelsFromString(robot_urdf("crawler"), "urdf")
    plant.Finalize()
    with pytest.raises(ConfigError, match="not those of a snake"):
        SnakeDrives(SnakeDriver(), plant, plant.GetModelInstanceByName("crawler"))


def test_actuators_without_gains_are_refused():
    plant = MultibodyPlant(0.005)
    urdf = snake_urdf(SHORT)
    start = urdf.index("<drake:controller_gains")
    Parser(plant).AddModelsFromString(urdf[:start] + urdf[urdf.index("/>", start) + 2 :], "urdf")
    plant.Finalize()
    with pytest.raises(ConfigError, match="controller_gains"):
        SnakeDrives(SnakeDriver(), plant, plant.GetModelInstanceByName("snake"))


def test_an_unknown_model_and_a_bad_value_are_named():
    plant = MultibodyPlant(0.005)
    Parser(plant).AddModelsFromString(snake_urdf(SHORT), "urdf")
    plant.Finalize()
    with pytest.raises(ConfigError, match="'worm'"):
        ApplyDriverConfig(SnakeDriver(), "worm", plant, {}, None, DiagramBuilder())
    with pytest.raises(ConfigError, match="joint_max_rate"):
        SnakeDrives(SnakeDriver(joint_max_rate=-1.0), plant, plant.GetModelInstanceByName("snake"))


def test_drives_are_freed():
    plant = MultibodyPlant(0.005)
    Parser(plant).AddModelsFromString(snake_urdf(SHORT), "urdf")
    plant.Finalize()
    drives = SnakeDrives(SnakeDriver(), plant, plant.GetModelInstanceByName("snake"))
    reference = weakref.ref(drives)
    del drives
    gc.collect()
    assert reference() is None
