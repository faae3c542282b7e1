from dataclasses import replace

import numpy as np
import pytest
from naraha.models.snake.snake_model import SnakeModel
from naraha.models.worlds import load_world
from naraha.models.worlds.stuck import GEOMETRIC, KINDS, stuck_case
from naraha.systems.errors import WorldError

from tests.snake.stuck_snake import driven, settled

every_kind = pytest.mark.parametrize("kind", KINDS)


@every_kind
@pytest.mark.parametrize("stuck", [True, False])
def test_worlds_differ_by_seed_and_repeat_with_it(kind, stuck):
    first, again, other = (stuck_case(kind, seed, stuck=stuck) for seed in (3, 3, 4))
    assert first.world == again.world
    assert first.world != other.world
    np.testing.assert_array_equal(first.joint_command, again.joint_command)
    assert 1 <= first.unit <= SnakeModel().units - 2


@every_kind
def test_another_friction_changes_nothing_else(kind):
    case, slick = stuck_case(kind, 7), stuck_case(kind, 7, friction=0.0)
    assert slick.unit == case.unit
    np.testing.assert_array_equal(slick.joint_command, case.joint_command)
    np.testing.assert_array_equal(slick.X_WB.GetAsMatrix4(), case.X_WB.GetAsMatrix4())
    for solid, other in zip(case.world.solids, slick.world.solids, strict=True):
        assert replace(other, friction=solid.friction) == solid


@every_kind
def test_worlds_can_be_loaded_by_name(kind):
    assert load_world(f"stuck_{kind}", 2) == stuck_case(kind, 2).world


@every_kind
def test_the_snake_is_stuck(kind):
    _, run = settled(kind, 1, sensors=False)
    assert abs(driven(run, 3.0)) < 0.01


@pytest.mark.parametrize("kind", GEOMETRIC)
def test_no_thrust_helps_where_the_shape_holds(kind):
    _, run = settled(kind, 1, friction=0.0, sensors=False)
    assert abs(driven(run, 2.0, wheel_torque=1.0)) < 0.01


@pytest.mark.parametrize("kind", sorted(set(KINDS) - set(GEOMETRIC)))
def test_without_friction_the_snake_goes_on_where_friction_held_it(kind):
    _, run = settled(kind, 1, friction=0.0, sensors=False)
    # On the step, the next wheels meet the riser after some 5 cm.
    assert driven(run, 2.0) > 0.03


def test_there_are_worlds_that_look_alike_in_which_the_snake_is_not_stuck():
    for kind in (1, 2, 3, 4):
        _, run = settled(kind, 1, stuck=False, sensors=False)
        assert driven(run, 1.0) > 0.05


def test_an_unknown_class_and_too_short_a_snake_are_refused():
    with pytest.raises(WorldError, match="valid: 1, 2, 3, 4, 5"):
        stuck_case(6)
    with pytest.raises(WorldError, match="too short"):
        stuck_case(1, snake=SnakeModel(units=6))


def test_a_longer_snake_is_stuck_too():
    case = stuck_case(1, 0, snake=SnakeModel(units=14, length_step=4))
    assert len(case.joint_angles) == 27
    case.world.check("a longer snake")
