import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from naraha.systems.drive import effective_gauge, quasi_static_twist, slip_offset, turn_rate, twist_to_track_speeds
from naraha.systems.errors import InputError
from scipy.integrate import quad

size = st.floats(0.05, 3.0)


def two_tracks(length, gauge, count):
    """Midpoints of equal parts of both tracks: points (2 count, 2), +1 on the right and -1 on the left."""
    x = ((np.arange(count) + 0.5) / count - 0.5) * length
    points = np.vstack([np.column_stack([x, np.full(count, side * gauge / 2)]) for side in (1, -1)])
    return points, np.repeat([-1.0, 1.0], count)


@given(length=size, gauge=size)
def test_the_offset_balances_the_moments_of_the_derivation(length, gauge):
    a = slip_offset(length, gauge)
    moment, _ = quad(lambda x: (gauge / 2 * a - x * x) / math.hypot(a, x), -length / 2, length / 2, points=[0.0])
    assert moment == pytest.approx(0, abs=1e-7 * gauge * length)


def test_short_tracks_turn_like_wheels():
    assert effective_gauge(1e-6, 0.5) == pytest.approx(0.5, rel=1e-5)
    assert turn_rate(0.2, 1e-6, 0.5) == pytest.approx(0.2 / 0.25, rel=1e-5)


@given(length=size, gauge=size, scale=st.floats(0.1, 10))
def test_the_offset_scales_with_the_robot(length, gauge, scale):
    assert slip_offset(scale * length, scale * gauge) == pytest.approx(scale * slip_offset(length, gauge), rel=1e-9)


@pytest.mark.parametrize(("length", "gauge"), [(0.46, 0.24), (0.46, 0.28), (1.0, 0.5)])
def test_many_contact_points_turn_like_a_uniform_load(length, gauge):
    points, side = two_tracks(length, gauge, 400)
    v_x, v_y, omega = quasi_static_twist(points, np.ones(len(points)), 0.2 * side)
    assert omega == pytest.approx(turn_rate(0.2, length, gauge), rel=1e-4)
    np.testing.assert_allclose([v_x, v_y], 0, atol=1e-9)


@pytest.mark.parametrize(("v", "omega"), [(0.3, 0.2), (-0.1, 0.5), (0.0, -0.7)])
def test_the_effective_gauge_holds_for_every_turn(v, omega):
    length, gauge = 0.46, 0.24
    points, side = two_tracks(length, gauge, 400)
    left, right = twist_to_track_speeds(v, omega, effective_gauge(length, gauge))
    twist = quasi_static_twist(points, np.ones(len(points)), np.where(side > 0, right, left))
    np.testing.assert_allclose(twist, [v, 0, omega], atol=2e-4)


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 10_000), scale=st.floats(1e-3, 1e3))
def test_friction_forces_and_moment_balance_at_the_solution(seed, scale):
    rng = np.random.default_rng(seed)
    points, side = two_tracks(0.5, 0.3, 9)
    points = points + rng.normal(0, 0.01, points.shape)
    loads = rng.uniform(0.2, 1.0, len(points))
    speeds = np.where(side > 0, rng.uniform(0.1, 0.4), rng.uniform(-0.4, 0.0))
    v_x, v_y, omega = quasi_static_twist(points, scale * loads, speeds)
    x, y = points.T
    slip = np.column_stack([v_x - omega * y - speeds, v_y + omega * x])
    length = np.linalg.norm(slip, axis=1)
    assert length.min() > 1e-6  # every point slips, so friction is fully developed
    force = -loads[:, None] * slip / length[:, None]
    np.testing.assert_allclose(force.sum(0), 0, atol=1e-6)
    assert x @ force[:, 1] - y @ force[:, 0] == pytest.approx(0, abs=1e-6)


def test_equal_belts_drive_straight_without_slip():
    points, _ = two_tracks(0.46, 0.24, 9)
    twist = quasi_static_twist(points, np.linspace(1, 2, len(points)), np.full(len(points), 0.3))
    np.testing.assert_allclose(twist, [0.3, 0, 0], atol=1e-9)


def test_load_at_the_ends_makes_turning_harder():
    points, side = two_tracks(0.46, 0.24, 9)
    at_ends = 1.0 + 20 * points[:, 0] ** 2
    even = quasi_static_twist(points, np.ones(18), 0.2 * side)[2]
    assert quasi_static_twist(points, at_ends, 0.2 * side)[2] < 0.97 * even


def test_bad_input_is_refused():
    with pytest.raises(InputError, match="length"):
        slip_offset(0.0, 0.3)
    with pytest.raises(InputError, match="gauge"):
        turn_rate(0.1, 0.3, math.nan)
    with pytest.raises(InputError, match="shapes"):
        quasi_static_twist(np.zeros((3, 3)), np.ones(3), np.ones(3))
    with pytest.raises(InputError, match="two loaded"):
        quasi_static_twist(np.zeros((3, 2)), np.array([1.0, 0, 0]), np.ones(3))
