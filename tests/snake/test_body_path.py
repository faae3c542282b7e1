import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.errors import ConfigError
from naraha.systems.snake import BodyPath, edge_radius, fit_shape, path_of_body, path_over_ground

shapes = st.lists(st.floats(-0.7, 0.7), min_size=11, max_size=11).map(np.array)
L = 0.09


def circle(radius, up=0.0):
    t = np.linspace(0.0, 6.0, 3000)
    return BodyPath(np.column_stack([radius * np.sin(t), radius * (1 - np.cos(t)), up * t]), 0.0)


@given(angles=shapes)
def test_a_body_on_its_own_line_keeps_its_angles(angles):
    path = path_of_body(angles, L, 1.0)
    np.testing.assert_allclose(fit_shape(path, path.start, 6, L).angles, angles, atol=1e-5)


@given(angles=shapes)
def test_one_unit_further_on_every_unit_has_the_angles_of_the_one_in_front(angles):
    path = path_of_body(angles, L, 1.0)
    shape = fit_shape(path, path.start + 2 * L, 6, L)
    np.testing.assert_allclose(shape.angles[2:], angles[:-2], atol=1e-5)
    np.testing.assert_allclose(shape.angles[:2], 0.0, atol=1e-5)


def test_the_shape_goes_on_smoothly():
    angles = 0.4 * np.random.default_rng(0).standard_normal(19)
    path = path_of_body(angles, L, 1.0)
    moved = [fit_shape(path, path.start + s, 10, L).angles for s in np.linspace(0, 2 * L, 400)]
    assert np.abs(np.diff(moved, axis=0)).max() < 0.01


def test_on_a_circle_all_yaw_angles_are_equal_and_axles_stay_near_it():
    shape = fit_shape(circle(0.6), 3.0, 10, L)
    np.testing.assert_allclose(shape.angles[3::2], -2 * L / 0.6, atol=0.01)
    np.testing.assert_allclose(shape.angles[::2], 0.0, atol=1e-9)
    radii = np.hypot(shape.axles[:, 0], shape.axles[:, 1] - 0.6)
    np.testing.assert_allclose(radii, 0.6, atol=0.01)


def test_a_helix_is_followed_in_space():
    path = circle(0.8, up=0.3)
    shape = fit_shape(path, 3.5, 10, L)
    nearest = [np.linalg.norm(path.points - axle, axis=1).min() for axle in shape.axles]
    assert max(nearest) < 0.02
    assert np.ptp(shape.axles[:, 2]) > 0.4


def test_over_a_step_every_axle_is_on_the_path():
    ground = path_over_ground(np.array([[-3, 0], [0, 0], [0, 0.15], [3, 0.15]]), 0.05, edge_radius=0.095, smoothing=0.1)
    path = BodyPath(ground, 0.0)
    shape = fit_shape(path, 3.2, 10, L)
    assert max(np.linalg.norm(path.points - axle, axis=1).min() for axle in shape.axles) < 2e-3
    np.testing.assert_allclose(shape.angles[1::2], 0.0, atol=1e-9)


def test_frames_and_axles_are_those_of_the_angles():
    shape = fit_shape(circle(0.6, up=0.2), 3.0, 5, L)
    R = shape.frames[1].copy()
    step = shape.axles[1] - shape.axles[2]
    c, s = np.cos(shape.angles[2]), np.sin(shape.angles[2])
    x_rear = c * R[:, 0] - s * R[:, 2]
    np.testing.assert_allclose(step, L * (x_rear + shape.frames[2][:, 0]), atol=1e-12)


def test_a_wheel_rides_its_radius_over_flats_and_around_edges():
    line = path_over_ground(np.array([[-1, 0], [0, 0], [0, 0.15], [1, 0.15]]), 0.05)
    assert np.interp(-0.5, line[:, 0], line[:, 2]) == pytest.approx(0.05)
    assert np.interp(0.5, line[:, 0], line[:, 2]) == pytest.approx(0.20)
    assert np.interp(-0.03, line[:, 0], line[:, 2]) == pytest.approx(0.15 + 0.04, abs=1e-3)


def test_the_belly_clears_an_edge_at_the_edge_radius():
    radius = edge_radius(L, 0.015, clearance=0.005)
    # The middle of a straight unit whose axles are both at that distance from the edge.
    assert np.sqrt(radius**2 - L**2) == pytest.approx(0.02)


def test_a_smoothed_line_is_nowhere_lower():
    profile = np.array([[-1, 0], [0, 0], [0, 0.15], [0.3, 0.15], [0.3, 0.3], [1, 0.3]])
    rough, smooth = path_over_ground(profile, 0.05), path_over_ground(profile, 0.05, smoothing=0.1)
    assert (smooth[:, 2] >= rough[:, 2] - 1e-9).all()
    assert np.abs(np.diff(smooth[:, 2])).max() < np.abs(np.diff(rough[:, 2])).max()


@pytest.mark.parametrize("points", [np.zeros((5, 3)), np.zeros((1, 3)), np.zeros((4, 2)), np.full((4, 3), np.nan)])
def test_what_is_no_path_is_refused(points):
    with pytest.raises(ConfigError, match="points"):
        BodyPath(points, 0.0)


def test_what_is_no_profile_is_refused():
    with pytest.raises(ConfigError, match="fall"):
        path_over_ground(np.array([[0, 0], [1, 0], [0.5, 0]]), 0.05)
