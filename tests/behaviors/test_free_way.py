import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from naraha.systems.behaviors import braked, free_arc, free_ways


def test_a_disc_stops_where_its_rim_meets_a_point():
    points = np.array([[2.0, 0.0], [0.0, 1.5]])
    ways = free_ways(points, np.deg2rad([-90, 0, 90, 180]), 0.3, 5.0)
    np.testing.assert_allclose(ways, [5.0, 1.7, 1.2, 5.0])
    (beside,) = free_ways(np.array([[1.0, 0.18]]), np.zeros(1), 0.3, 5.0)
    assert beside == pytest.approx(1.0 - 0.24)
    assert free_ways(np.array([[1.0, 0.31]]), np.zeros(1), 0.3, 5.0) == 5.0


def test_nothing_seen_is_free_as_far_as_it_matters():
    np.testing.assert_array_equal(free_ways(np.zeros((0, 2)), np.zeros(3), 0.3, 2.0), [2.0, 2.0, 2.0])
    assert free_arc(np.zeros((0, 2)), 1.0, 0.5, 0.3) == np.inf


def test_a_point_that_is_covered_stops_what_leads_to_it_only():
    points = np.array([[0.1, 0.0]])
    np.testing.assert_array_equal(free_ways(points, np.array([0.0, np.pi]), 0.3, 2.0), [0.0, 2.0])


@settings(deadline=None, max_examples=60)
@given(
    st.floats(0.1, 1.0),
    st.floats(-1.5, 1.5),
    st.lists(st.tuples(st.floats(-3, 3), st.floats(-3, 3)), min_size=1, max_size=6),
)
def test_the_free_arc_is_that_of_small_steps(v, omega, points):
    radius, points = 0.3, np.array(points)
    points = points[np.hypot(*points.T) > radius + 1e-3]
    time = np.arange(0, min(4.0 / v, 2 * np.pi / max(abs(omega), 1e-9)), 1e-3 / v)
    if abs(omega) < 1e-4:
        omega = 0.0
    x = v * time if omega == 0 else v / omega * np.sin(omega * time)
    y = 0 * time if omega == 0 else v / omega * (1 - np.cos(omega * time))
    away = np.hypot(x[:, None] - points[:, 0], y[:, None] - points[:, 1]).min(axis=1, initial=np.inf)
    found = free_arc(points, v, omega, radius)
    touching = np.flatnonzero(away < radius)
    if len(touching):
        # Steps that just graze a point may miss it, never the other way round.
        assert found <= v * time[touching[0]] + 1e-6
    if np.isfinite(found) and found < v * time[-1]:
        assert away[np.searchsorted(v * time, found)] == pytest.approx(radius, abs=2e-3)


def test_braking_leaves_room_to_stop_and_never_speeds_up():
    points = np.array([[1.0, 0.0]])
    for v in (0.2, 0.5, 0.8):
        speed = braked(v, 0.0, points, 0.3, 0.5, 0.2)
        assert speed <= v
        assert speed * 0.2 + speed**2 / (2 * 0.5) <= 0.7
    assert braked(0.3, 0.0, points, 0.3, 0.5, 0.2) == pytest.approx(0.3)
    assert braked(0.8, 0.0, np.array([[0.31, 0.0]]), 0.3, 0.5, 0.2) == 0.0
