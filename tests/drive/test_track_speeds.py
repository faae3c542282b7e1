import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.drive import (
    limit_track_acceleration,
    limit_track_speeds,
    track_speeds_to_twist,
    twist_to_track_speeds,
)

speed = st.floats(-3, 3)
pair = st.tuples(speed, speed).map(np.array)
positive = st.floats(0.01, 3)


@given(v=speed, omega=speed, gauge=positive)
def test_twist_and_track_speeds_are_inverse(v, omega, gauge):
    np.testing.assert_allclose(
        track_speeds_to_twist(twist_to_track_speeds(v, omega, gauge), gauge), [v, omega], atol=1e-9
    )


def test_a_left_turn_runs_the_right_track_faster():
    np.testing.assert_allclose(twist_to_track_speeds(0.2, 0.5, 0.4), [0.1, 0.3])


@given(speeds=pair, limit=positive)
def test_limited_speeds_keep_their_ratio_and_are_as_fast_as_allowed(speeds, limit):
    limited = limit_track_speeds(speeds, limit)
    assert np.abs(limited).max() == pytest.approx(min(limit, np.abs(speeds).max()))
    assert limited[0] * speeds[1] == pytest.approx(limited[1] * speeds[0], abs=1e-9)
    assert limited @ speeds >= 0


@given(previous=pair, target=pair, change=positive)
def test_limited_acceleration_stays_on_the_way_to_the_target(previous, target, change):
    reached = limit_track_acceleration(previous, target, change)
    gap = np.abs(target - previous).max()
    if gap <= change:
        np.testing.assert_allclose(reached, target, atol=1e-12)
    else:
        np.testing.assert_allclose(reached, previous + (target - previous) * change / gap, atol=1e-12)


def test_a_start_from_rest_keeps_the_curvature():
    first = limit_track_acceleration(np.zeros(2), np.array([0.1, 0.3]), 0.03)
    np.testing.assert_allclose(first, [0.01, 0.03])
