import numpy as np
import pytest
from naraha.models.snake.snake_model import SnakeModel
from naraha.systems.errors import ConfigError
from naraha.systems.snake import SnakeBody, middle_in_head, plan_motion
from naraha.systems.snake.recovery_planner import (
    Proposal,
    RecoveryPlanner,
    RecoveryPlannerConfig,
    Rehearsal,
    propose,
    rank,
)
from naraha.systems.snake.snake_pilot import Move
from naraha.systems.snake.stuck_rules import Diagnosis
from pydrake.common.value import AbstractValue

MODEL = SnakeModel()
BODY = SnakeBody(MODEL.half_length, MODEL.wheel_radius, MODEL.tread, np.array(MODEL.joint_limits()))
CONFIG = RecoveryPlannerConfig()
STRAIGHT = np.zeros(19)


def stuck_at(unit, kind=1):
    return Diagnosis(stuck=True, probability=1.0, kind=kind, unit=unit, confidence=1.0)


def test_nothing_is_proposed_to_a_snake_that_is_not_stuck():
    assert propose(Diagnosis(), STRAIGHT, np.zeros(3), BODY, CONFIG).items == ()


@pytest.mark.parametrize("unit", range(10))
def test_every_proposed_recovery_can_be_planned_wherever_the_snake_is_stuck(unit):
    items = propose(stuck_at(unit), STRAIGHT, np.zeros(3), BODY, CONFIG).items
    commands = [move.recovery for item in items for move, _ in item.moves if move.recovery]
    assert len(commands) >= 2
    for command in commands:
        plan_motion(STRAIGHT, command, BODY.half_length)
        assert command.first_unit <= max(unit, 2)


@pytest.mark.parametrize("pitch", [0.0, 0.5, -0.4])
def test_targets_are_above_the_body_by_gravity_not_by_the_head(pitch):
    first = next(p for p in propose(stuck_at(5), STRAIGHT, np.array([0, pitch, 0]), BODY, CONFIG).items if not p.cheap)
    command = first.moves[0][0].recovery
    lift = np.array(command.target) - middle_in_head(STRAIGHT, command.first_unit, command.last_unit, BODY.half_length)
    c, s = np.cos(pitch), np.sin(pitch)
    up = -s * lift[0] + c * lift[2]
    assert up == pytest.approx(CONFIG.lifts[0], abs=1e-9)


def test_the_cheap_moves_of_an_operator_are_always_among_the_proposals():
    for kind in (1, 2, 3, 4, 5):
        names = [item.name for item in propose(stuck_at(4, kind), STRAIGHT, np.zeros(3), BODY, CONFIG).items]
        assert {"shift", "relax", "reverse", "torque", "recover"} == set(names)


def test_the_best_rehearsal_comes_first_and_what_fails_or_tips_over_last():
    proposal = Proposal("shift", ((Move(kind="shift", speed=0.1), 1.0),), True)
    good = Rehearsal(0.6, 0.0, 0.08, 0.5, 0.0, 5.0)
    slow = Rehearsal(0.6, 0.0, 0.08, 0.5, 0.0, 15.0)
    tipping = Rehearsal(0.9, 0.0, -0.02, 0.5, 0.0, 5.0)
    held = Rehearsal(0.1, 0.0, 0.08, 0.5, 0.0, 1.0)
    lost = Rehearsal(np.nan, 0.0, 0.08, 0.5, 0.0, 1.0)
    ranked = rank([(proposal, result) for result in (held, tipping, slow, lost, good)], CONFIG)
    assert [item.rehearsal for item in ranked[:2]] == [good, slow]
    assert all(item.score == -np.inf and item.objection for item in ranked[2:])


def test_nothing_is_planned_on_a_body_whose_shape_is_not_known():
    planner = RecoveryPlanner(CONFIG, body=BODY)
    context = planner.CreateDefaultContext()
    angles = STRAIGHT.copy()
    angles[3] = np.nan
    planner.GetInputPort("joint_angles").FixValue(context, angles)
    planner.GetInputPort("rpy").FixValue(context, np.zeros(3))
    planner.GetInputPort("diagnosis").FixValue(context, AbstractValue.Make(stuck_at(4)))
    assert planner.GetOutputPort("proposals").Eval(context).items == ()


def test_values_out_of_range_are_refused():
    with pytest.raises(ConfigError, match=r"planner\.speed"):
        RecoveryPlanner(RecoveryPlannerConfig(speed=0.0), body=BODY)
