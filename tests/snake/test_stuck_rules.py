import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.snake.stuck_features import SnakeMeasures, StuckFeatures
from naraha.systems.snake.stuck_rules import (
    Diagnosis,
    StuckRules,
    blocked_unit,
    class_scores,
    diagnose,
    stuck_probability,
)

N = 10
MEASURES = SnakeMeasures(units=N, half_length=0.09, wheel_radius=0.05, clearance=0.035, wheel_side=0.037, weight=93.0)
RULES = StuckRules()


def features(**changes):
    free = {
        "wheel_speed": 0.1,
        "command_speed": 0.1,
        "body_speed": 0.1,
        "thrust": 0.0,
        "belly_loads": np.zeros(2 * N),
        "yaw_torques": np.zeros(N - 1),
        "axle_heights": np.zeros(N),
        "under": np.full(2 * N, 0.035),
        "beside": np.full((2, 2 * N), 0.3),
    }
    return StuckFeatures(**(free | changes))


def at(count, index, value, elsewhere):
    array = np.full(count, elsewhere)
    array[index] = value
    return array


def test_a_robot_that_drives_is_not_stuck_and_one_that_pushes_and_stands_is():
    assert stuck_probability(features(), MEASURES, RULES) < 0.05
    assert stuck_probability(features(body_speed=0.0, thrust=60.0), MEASURES, RULES) > 0.95


@given(speed=st.floats(-0.1, 0.1), thrust=st.floats(-80, 80), load=st.floats(0, 50))
def test_a_robot_that_is_not_to_drive_is_never_stuck(speed, thrust, load):
    f = features(command_speed=0.0, body_speed=speed, thrust=thrust, belly_loads=np.full(2 * N, load))
    assert stuck_probability(f, MEASURES, RULES) == 0


@given(speed=st.floats(-0.1, 0.2), thrust=st.floats(-80, 80))
def test_backwards_is_the_mirror_image_of_forwards(speed, thrust):
    ahead = features(body_speed=speed, thrust=thrust)
    back = features(command_speed=-0.1, wheel_speed=-0.1, body_speed=-speed, thrust=-thrust)
    assert stuck_probability(back, MEASURES, RULES) == pytest.approx(stuck_probability(ahead, MEASURES, RULES))


def test_the_thrust_that_lifts_the_robot_does_not_count():
    climbing = features(body_speed=0.06, thrust=30.0, axle_heights=np.linspace(0.6, 0.0, N))
    level = features(body_speed=0.06, thrust=30.0)
    assert stuck_probability(climbing, MEASURES, RULES) < stuck_probability(level, MEASURES, RULES)


bend = np.zeros(N - 1)
bend[3:7] = 10.0, -12.0, -12.0, 10.0  # yaw joints 3 to 6: the middle is unit 5
CASES = {
    1: ({"under": at(2 * N, 9, 0.003, 0.035)}, 5),
    2: ({"yaw_torques": bend}, 5),
    3: ({"beside": np.vstack([at(2 * N, 8, 0.006, 0.3)] * 2)}, 4),
    4: ({"belly_loads": at(2 * N, 11, 25.0, 0.0), "under": at(2 * N, 11, 0.001, 0.035)}, 5),
    5: (
        {
            "belly_loads": at(2 * N, 7, 25.0, 0.0),
            "under": at(2 * N, 7, 0.001, 0.035),
            "axle_heights": np.where(np.arange(N) <= 3, 0.0, -0.12),
        },
        3,
    ),
}


@pytest.mark.parametrize("kind", CASES)
def test_every_class_is_told_by_what_touches_and_where(kind):
    changes, unit = CASES[kind]
    f = features(body_speed=0.0, thrust=50.0, **changes)
    diagnosis = diagnose(f, 0.9, True, MEASURES, RULES)
    assert (diagnosis.kind, diagnosis.unit) == (kind, unit)
    assert 0.5 < diagnosis.confidence <= 1
    assert diagnosis.in_words != Diagnosis().in_words


@given(
    loads=st.lists(st.floats(0, 80), min_size=2 * N, max_size=2 * N),
    torques=st.lists(st.floats(-15, 15), min_size=N - 1, max_size=N - 1),
    under=st.lists(st.floats(0, 0.3), min_size=2 * N, max_size=2 * N),
)
def test_scores_are_probabilities_and_units_are_units_whatever_is_measured(loads, torques, under):
    f = features(belly_loads=np.array(loads), yaw_torques=np.array(torques), under=np.array(under))
    scores, units = class_scores(f, MEASURES, RULES)
    assert scores.sum() == pytest.approx(1)
    assert np.all(scores >= 0)
    assert np.all((units >= 0) & (units < N))


def test_what_stands_at_a_half_blocks_the_next_axle():
    assert [blocked_unit(half) for half in (0, 1, 2, 3, 19)] == [0, 1, 1, 2, 10]


def test_a_free_robot_has_no_class_and_no_place():
    diagnosis = diagnose(features(), 0.1, False, MEASURES, RULES)
    assert (diagnosis.stuck, diagnosis.kind, diagnosis.unit) == (False, 0, -1)
