"""Motion of constant twist during a sweep."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.sensing import deskew, interpolate_pose
from naraha.systems.sensing.deskew import relative_twist, rotation_vector
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

twists = st.tuples(*[st.floats(-1.5, 1.5)] * 6).map(np.array)


def hat(twist):
    x, y, z = twist[:3]
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    matrix[:3, 3] = twist[3:]
    return matrix


@given(twist=twists)
def test_relative_twist_is_the_logarithm_of_the_pose(twist):
    rotation, v = relative_twist(expm(hat(twist)))
    np.testing.assert_allclose(np.concatenate([rotation, v]), twist, atol=1e-7)


@pytest.mark.parametrize("angle", [0, 1e-12, 1e-9, 1.1e-9, 1e-6, 1e-5, 1e-3, 1, 3, np.pi - 1e-6])
def test_interpolated_poses_are_the_exponential_at_every_size_of_turn(angle):
    twist = np.array([2, -1, 2, 0, 0, 0]) / 3 * angle + np.array([0, 0, 0, 1, 2, -0.5])
    fraction = np.array([0, 0.25, 0.6, 1])
    R, p = interpolate_pose(expm(hat(twist)), fraction)
    for i, part in enumerate(fraction):
        np.testing.assert_allclose(R[i], expm(hat(part * twist))[:3, :3], atol=1e-9)
        np.testing.assert_allclose(p[i], expm(hat(part * twist))[:3, 3], atol=1e-8)


def test_deskew_undoes_a_sweep_at_walking_speed_within_a_millimetre():
    rng = np.random.default_rng(0)
    count, period = 28800, 0.1
    p_WP = rng.uniform(-30, 30, (count, 3))
    time = rng.uniform(0, 1, count)
    twist = period * np.concatenate([[0.2, -0.1, 1.0], [1.0, 0.1, 0.05]])
    # Every point as a sensor sees it that starts at the origin: p_S = X_SW(t) p_W.
    poses = np.array([expm(-hat(part * twist)) for part in np.linspace(0, 1, 201)])
    step = np.round(time * 200).astype(int)
    p_SP = np.einsum("nij,nj->ni", poses[step, :3, :3], p_WP) + poses[step, :3, 3]
    X_WS1 = expm(hat(twist))
    truth = (p_WP - X_WS1[:3, 3]) @ X_WS1[:3, :3]

    undone = deskew(p_SP.astype(np.float32), step / 200, X_WS1)
    assert undone.dtype == np.float32
    assert np.abs(p_SP - truth).max() > 0.5
    assert np.linalg.norm(undone - truth, axis=1).max() < 1e-4


def test_deskew_without_motion_changes_nothing():
    points = np.random.default_rng(1).normal(size=(50, 3)).astype(np.float32)
    np.testing.assert_array_equal(deskew(points, np.linspace(0, 1, 50), np.eye(4)), points)


def test_points_of_the_end_stay_and_points_of_the_start_move_all_the_way():
    X_S0S1 = np.eye(4)
    X_S0S1[:3, :3] = Rotation.from_euler("zyx", [0.3, 0.2, -0.1]).as_matrix()
    X_S0S1[:3, 3] = [0.2, -0.1, 0.3]
    p = np.array([[1.0, 2, 3]])
    np.testing.assert_allclose(deskew(p, np.ones(1), X_S0S1), p, rtol=1e-6)
    np.testing.assert_allclose(deskew(p, np.zeros(1), X_S0S1), (p - X_S0S1[:3, 3]) @ X_S0S1[:3, :3], rtol=1e-6)


def test_deskew_of_no_points_gives_none():
    X_S0S1 = np.eye(4)
    X_S0S1[0, 3] = 1
    assert deskew(np.zeros((0, 3)), np.zeros(0), X_S0S1).shape == (0, 3)


@given(st.lists(st.floats(-1, 1), min_size=3, max_size=3), st.floats(0, 1) | st.sampled_from([1e-12, 1e-8, 1e-4]))
def test_a_rotation_vector_gives_its_rotation(axis, share):
    axis = np.array(axis)
    if np.linalg.norm(axis) < 1e-3:
        axis = np.array([0.0, 0.0, 1.0])
    R = Rotation.from_rotvec(np.pi * share * axis / np.linalg.norm(axis)).as_matrix()
    np.testing.assert_allclose(Rotation.from_rotvec(rotation_vector(R)).as_matrix(), R, atol=1e-9)
    assert np.linalg.norm(rotation_vector(R)) <= np.pi + 1e-9
