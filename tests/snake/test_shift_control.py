import numpy as np
import pytest
from naraha.systems.errors import ConfigError
from naraha.systems.snake import (
    NO_PATH,
    BodyPath,
    ShiftControl,
    ShiftControlConfig,
    edge_radius,
    fit_shape,
    path_over_ground,
)
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RotationMatrix

from tests.snake.robot import FLOOR, Snake, SnakeModel, snake_body

MODEL = SnakeModel()


class Shifting(Snake):
    """A snake whose driver obeys shift control, standing at the start of a path."""

    def __init__(self, path, *, boxes=(FLOOR,), config=None):
        def extend(builder, plant, driver):
            control = ShiftControl(config or ShiftControlConfig(), body=snake_body(MODEL))
            self.control = builder.AddNamedSystem("shift", control)
            for name in ("joint_command", "wheel_speed_command"):
                builder.Connect(control.GetOutputPort(name), driver.GetInputPort(name))
            builder.Connect(driver.GetOutputPort("wheel_speeds"), control.GetInputPort("wheel_speeds"))

        shape = fit_shape(path, path.start, MODEL.units, MODEL.half_length)
        R = RotationMatrix.ProjectToRotationMatrix(shape.frames[0])
        nose = RigidTransform(R, shape.axles[0]) @ RigidTransform([MODEL.half_length, 0, 0])
        super().__init__(MODEL, boxes=boxes, head=nose, angles=shape.angles, extend=extend)
        self.path, self.control_context = path, self.control.GetMyContextFromRoot(self.context)
        self.follow(path)
        self.speed(0.0)
        self.run(0.5)

    def follow(self, path):
        self.control.GetInputPort("path").FixValue(self.control_context, Value(path))

    def speed(self, value):
        self.control.GetInputPort("speed_command").FixValue(self.control_context, [value])

    def value(self, name):
        return self.control.GetOutputPort(name).Eval(self.control_context)

    def axles(self):
        return np.array([self.X_W(f"R{i}").translation() for i in range(MODEL.units)])

    def wanted(self):
        at = self.path.start + self.value("progress")[0]
        return fit_shape(self.path, at, MODEL.units, MODEL.half_length).axles


def ground_path(y=lambda x: 0 * x):
    x = np.arange(-3.0, 4.0, 0.01)
    points = np.column_stack([x, y(x), np.full_like(x, MODEL.wheel_radius)])
    lengths = BodyPath(points, 0.0).lengths
    return BodyPath(points, float(np.interp(0.0, x, lengths)))


def flight(steps, rise, run):
    """Boxes of a flight of steps from x = 0.3 on, and the path over it from x = 0."""
    profile, boxes = [(-3.0, 0.0)], [FLOOR]
    for i in range(steps):
        x = 0.3 + i * run
        profile += [(x, i * rise), (x, (i + 1) * rise)]
        boxes.append(((x + 2.5, 0, (i + 0.5) * rise), (5, 3, rise)))
    profile.append((5.0, steps * rise))
    radius = edge_radius(MODEL.half_length, MODEL.belly_depth)
    points = path_over_ground(np.array(profile), MODEL.wheel_radius, edge_radius=radius, smoothing=0.1)
    path = BodyPath(points, 0.0)
    return boxes, BodyPath(points, float(np.interp(0.0, points[:, 0], path.lengths)))


def test_it_drives_a_straight_line():
    snake = Shifting(ground_path())
    snake.speed(0.2)
    snake.run(3.0)
    assert snake.value("progress")[0] == pytest.approx(0.6, abs=0.01)
    np.testing.assert_allclose(snake.axles(), snake.wanted(), atol=0.02)


def test_it_drives_a_slalom_on_the_track_of_its_head():
    snake = Shifting(ground_path(lambda x: np.where(x > 0, 0.1 * (1 - np.cos(2 * np.pi * x / 1.2)), 0)))
    snake.speed(0.2)
    for _ in range(12):
        snake.run(1.0)
        across = [np.linalg.norm(snake.path.points - axle, axis=1).min() for axle in snake.axles()]
        assert max(across) < 0.04
    assert snake.X_W("F0").translation()[0] > 2.0
    assert np.ptp(snake.axles()[:, 1]) > 0.15


def test_it_climbs_a_step_of_15_cm():
    boxes, path = flight(1, 0.15, 1.0)
    snake = Shifting(path, boxes=boxes, config=ShiftControlConfig(progress="measured"))
    snake.command(wheel_torque_limit=1.0)
    snake.speed(0.15)
    snake.run(25.0)
    assert snake.axles()[:, 2].min() > 0.15


@pytest.mark.slow
def test_it_climbs_stairs():
    boxes, path = flight(4, 0.15, 0.30)
    snake = Shifting(path, boxes=boxes, config=ShiftControlConfig(progress="measured"))
    snake.command(wheel_torque_limit=1.0)
    snake.speed(0.1)
    snake.run(75.0)
    assert snake.axles()[:, 2].min() > 0.6


@pytest.mark.parametrize(("progress", "goes_on"), [("commanded", True), ("measured", False)])
def test_in_front_of_a_wall_the_shape_waits_only_when_it_follows_what_is_measured(progress, goes_on):
    wall = ((0.65, 0.0, 0.25), (1.0, 2.0, 0.5))
    snake = Shifting(ground_path(), boxes=(FLOOR, wall), config=ShiftControlConfig(progress=progress))
    snake.speed(0.1)
    snake.command(wheel_torque_limit=0.12)  # the tyres slip at more
    snake.run(4.0)
    assert bool(snake.value("progress")[0] > 0.2) is goes_on


def test_what_is_no_speed_stops_it():
    snake = Shifting(ground_path())
    snake.speed(0.1)
    snake.run(0.5)
    snake.speed(np.nan)
    snake.run(0.5)
    before = snake.value("progress")[0]
    snake.run(0.5)
    assert snake.value("progress")[0] == before
    np.testing.assert_allclose(snake.value("wheel_speed_command"), 0.0, atol=1e-9)


def test_it_reverses_and_stops_at_the_ends_of_the_path():
    points = np.array([[-2.2, 0, 0.05], [0.4, 0, 0.05]])
    snake = Shifting(BodyPath(points, 2.2))
    snake.speed(-0.3)
    snake.run(1.0)
    assert snake.value("progress")[0] == pytest.approx(-0.3, abs=0.01)
    snake.speed(0.3)
    snake.run(4.0)
    assert snake.value("progress")[0] == pytest.approx(0.4 - MODEL.half_length)
    np.testing.assert_allclose(snake.value("wheel_speed_command"), 0.0, atol=1e-9)


def test_without_a_path_the_body_stays_and_a_new_one_begins_anew():
    snake = Shifting(ground_path())
    snake.speed(0.1)
    snake.run(0.5)
    snake.follow(NO_PATH)
    snake.run(0.1)
    assert np.isnan(snake.value("joint_command")).all()
    np.testing.assert_array_equal(snake.value("wheel_speed_command"), 0.0)
    snake.follow(BodyPath(snake.path.points, snake.path.start, number=7))
    snake.run(0.005)
    assert snake.value("progress")[0] < 0.01


def test_wheels_roll_at_their_own_speeds_in_a_bend():
    t = np.linspace(0.0, 6.0, 3000)
    circle = BodyPath(np.column_stack([0.8 * np.sin(t), 0.8 * (1 - np.cos(t)), np.full(3000, 0.05)]), 2.5)
    control = ShiftControl(ShiftControlConfig(), body=snake_body(MODEL))
    context = control.CreateDefaultContext()
    control.GetInputPort("path").FixValue(context, Value(circle))
    control.GetInputPort("speed_command").FixValue(context, [0.1])
    for _ in range(3):
        control._Move(context, context.get_mutable_state())
    rates = control.GetOutputPort("wheel_speed_command").Eval(context).reshape(-1, 2)
    yaw_rate = 0.1 / 0.8
    np.testing.assert_allclose((rates[:, 1] - rates[:, 0]) * 0.05, yaw_rate * MODEL.tread, rtol=0.1)
    np.testing.assert_allclose(rates.mean(axis=1) * 0.05, 0.1, rtol=0.03)


@pytest.mark.parametrize(("key", "value"), [("period", 0.0), ("progress", "hoped"), ("wheel_quantile", 2.0)])
def test_values_out_of_range_are_named(key, value):
    with pytest.raises(ConfigError, match=key):
        ShiftControl(ShiftControlConfig(**{key: value}), body=snake_body(MODEL))
