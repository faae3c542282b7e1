import gc
import weakref

import numpy as np
import pytest
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.snake import (
    NullSpaceConfig,
    NullSpaceRecovery,
    RecoveryCommand,
    SnakeBody,
    middle_in_head,
)
from pydrake.common.value import Value
from pydrake.math import RollPitchYaw

from tests.snake.robot import FLOOR, Snake, SnakeModel, snake_body

MODEL = SnakeModel()


class Recovering(Snake):
    """A snake on flat ground, or on and under other boxes, whose driver obeys the recovery."""

    def __init__(self, angles=None, config=None, dead=None, boxes=(FLOOR,)):
        def extend(builder, plant, driver):
            body = snake_body(MODEL)
            self.recovery = builder.AddNamedSystem(
                "recovery", NullSpaceRecovery(config or NullSpaceConfig(), body=body)
            )
            builder.Connect(driver.GetOutputPort("joint_angles"), self.recovery.GetInputPort("joint_angles"))
            for name in ("joint_command", "wheel_speed_command"):
                builder.Connect(self.recovery.GetOutputPort(name), driver.GetInputPort(name))

        super().__init__(MODEL, boxes=boxes, angles=angles, extend=extend)
        self.recovery_context = self.recovery.GetMyContextFromRoot(self.context)
        self.order(RecoveryCommand())
        if dead is not None:
            limit = np.full(19, MODEL.joint_torque)
            limit[dead] = 0.0
            self.command(joint_torque_limit=limit)
        self.run(0.5)

    def order(self, command):
        self.recovery.GetInputPort("command").FixValue(self.recovery_context, Value(command))

    def recover(self, first=3, last=7, offset=(0.09, 0.0, 0.15), seconds=8.0):
        """Runs until the recovery ends; returns its statuses and the places of the head."""
        target = middle_in_head(self.output("joint_angles"), first, last, MODEL.half_length) + offset
        self.order(RecoveryCommand(1, True, first, last, tuple(target)))
        statuses, head = [], [self.X_W("F0").translation()]
        for _ in range(round(seconds / 0.1)):
            self.run(0.1)
            statuses.append(self.value("status"))
            head.append(self.X_W("F0").translation())
            if statuses[-1].phase in ("done", "stopped", "refused"):
                break
        return statuses, np.array(head)

    def value(self, name):
        return self.recovery.GetOutputPort(name).Eval(self.recovery_context)


@pytest.mark.parametrize(
    ("angles", "offset"),
    [
        (np.zeros(19), (0.09, 0.0, 0.15)),
        (np.r_[0.0, np.ravel([[0.35 * np.sin(i), 0.0] for i in range(9)])], (0.09, 0.05, 0.15)),
    ],
    ids=["straight", "bent"],
)
def test_the_middle_goes_to_the_target_while_the_head_stands_still(angles, offset):
    snake = Recovering(angles)
    statuses, head = snake.recover(offset=offset)
    assert statuses[-1].phase == "done", statuses[-1].reason
    assert np.linalg.norm(head - head[0], axis=1).max() < 0.02
    assert max(np.linalg.norm(status.control_error[:3]) for status in statuses) < 5e-3
    assert statuses[-1].distance < 0.6 * statuses[0].distance
    assert min(status.joint_margin for status in statuses) > 0
    np.testing.assert_allclose(snake.value("control_error"), statuses[-1].control_error)
    assert snake.value("target_distance")[0] == pytest.approx(statuses[-1].distance)


def test_a_target_inside_an_obstacle_stops_the_recovery_and_the_blocked_joint_is_named():
    ceiling = ((-0.9, 0.0, 0.34), (0.7, 1.0, 0.4))  # from z = 0.14 m up, 4 cm over the wheels
    snake = Recovering(boxes=(FLOOR, ceiling))
    statuses, head = snake.recover(offset=(0.09, 0.0, 0.24))
    assert statuses[-1].phase == "stopped"
    assert "p5 does not follow: it is blocked" in statuses[-1].reason
    assert statuses[-1].progress < 0.3
    assert np.abs(snake.output("joint_torques")).max() <= MODEL.joint_torque + 1e-6
    # Pressed between floor and ceiling the body gives way, but it stays on its wheels and holds from then on.
    assert np.linalg.norm(head - head[0], axis=1).max() < 0.06
    assert abs(RollPitchYaw(snake.X_W("F0").rotation()).roll_angle()) < 0.02
    held = snake.value("joint_command").copy()
    snake.run(0.5)
    np.testing.assert_array_equal(snake.value("joint_command"), held)


def test_before_a_command_joints_and_wheels_are_left_alone():
    snake = Recovering()
    assert np.isnan(snake.value("joint_command")).all()
    np.testing.assert_array_equal(snake.value("wheel_speed_command"), 0.0)
    assert snake.value("status").phase == "idle"
    np.testing.assert_allclose(snake.output("joint_angles"), 0.0, atol=0.01)


def test_a_dead_actuator_that_the_segment_needs_is_named():
    snake = Recovering(dead=10)
    statuses, _ = snake.recover()
    assert statuses[-1].phase == "stopped"
    assert "p5" in statuses[-1].reason


def test_without_an_actuator_that_the_others_can_replace_it_arrives():
    snake = Recovering(dead=9)
    statuses, head = snake.recover()
    assert statuses[-1].phase == "done", statuses[-1].reason
    assert max(np.linalg.norm(status.control_error[:3]) for status in statuses) < 5e-3
    assert np.linalg.norm(head - head[0], axis=1).max() < 0.02


def test_what_is_refused_leaves_the_robot_as_it_is():
    snake = Recovering()
    before = snake.X_W("R9").translation()
    snake.order(RecoveryCommand(1, True, 7, 12, (-1.0, 0.0, 0.2)))
    snake.run(1.0)
    assert snake.value("status").phase == "refused"
    assert "outside the body" in snake.value("status").reason
    assert np.linalg.norm(snake.X_W("R9").translation() - before) < 1e-3


def system(**changes):
    return NullSpaceRecovery(NullSpaceConfig(**changes), body=snake_body(MODEL))


def test_a_command_of_another_type_is_named():
    recovery = system()
    context = recovery.CreateDefaultContext()
    recovery.GetInputPort("command").FixValue(context, Value(object()).Clone())
    recovery.GetInputPort("joint_angles").FixValue(context, np.zeros(19))
    with pytest.raises(PortError, match="command"):
        recovery._Tick(context, context.get_mutable_state())


def test_missing_angles_are_named():
    recovery = system()
    context = recovery.CreateDefaultContext()
    recovery.GetInputPort("command").FixValue(context, Value(RecoveryCommand()))
    with pytest.raises(PortError, match="joint_angles"):
        recovery._Tick(context, context.get_mutable_state())


def test_values_out_of_range_are_named():
    with pytest.raises(ConfigError, match="max_joint_rate"):
        system(max_joint_rate=0.0)
    with pytest.raises(ConfigError, match="joint_limits"):
        SnakeBody(0.09, 0.05, 0.16, np.ones(4))
    with pytest.raises(ConfigError, match="tread"):
        SnakeBody(0.09, 0.05, -0.16, np.ones(5))


def test_it_is_freed():
    reference = weakref.ref(system())
    gc.collect()
    assert reference() is None
