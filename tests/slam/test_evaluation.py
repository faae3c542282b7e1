"""Errors of trajectories and maps on cases that can be computed by hand."""

import numpy as np
import pytest
from naraha.systems.slam import Keyframe, map_error, rebuild_map, trajectory_error
from pydrake.math import RigidTransform, RollPitchYaw

from tests.rooms import make_cloud, pose

TIMES = np.arange(5.0)
LINE = np.array([RigidTransform([t, 0, 0]).GetAsMatrix4() for t in TIMES])


def test_the_same_trajectory_has_no_error():
    assert trajectory_error(TIMES, LINE, TIMES, LINE) == (0, 0)


def test_errors_are_distances_of_positions():
    estimate = LINE.copy()
    estimate[2, :3, 3] += [0, 3, 4]
    assert trajectory_error(TIMES, estimate, TIMES, LINE) == pytest.approx((1.0, 5.0))


def test_the_first_pose_can_be_aligned_or_not():
    X = RigidTransform(RollPitchYaw(0.3, -0.2, 1.0), [5, 6, 7])
    moved = X.GetAsMatrix4() @ LINE
    assert trajectory_error(TIMES, moved, TIMES, LINE) == pytest.approx((0, 0), abs=1e-12)
    mean, largest = trajectory_error(TIMES, moved, TIMES, LINE, align="none")
    distances = np.linalg.norm(moved[:, :3, 3] - LINE[:, :3, 3], axis=1)
    assert (mean, largest) == pytest.approx((distances.mean(), distances.max()))


def test_truth_is_interpolated_along_the_arc():
    """On a quarter circle, half way at constant twist is half way on the arc, not on the chord."""
    ends = [RigidTransform([2, 0, 0]), RigidTransform(RollPitchYaw(0, 0, np.pi / 2), [0, 2, 0])]
    half = RigidTransform(RollPitchYaw(0, 0, np.pi / 4), [np.sqrt(2), np.sqrt(2), 0])
    truth = np.array([X.GetAsMatrix4() for X in ends])
    estimate = np.array([ends[0].GetAsMatrix4(), half.GetAsMatrix4()])
    assert trajectory_error([0, 0.5], estimate, [0, 1], truth) == pytest.approx((0, 0), abs=1e-12)


def test_estimates_outside_the_time_of_the_truth_do_not_count():
    times = np.array([-1.0, 0.0, 1.0, 9.0])
    estimate = np.array([RigidTransform([x, 0, 0]).GetAsMatrix4() for x in (50, 0, 1, 50)])
    assert trajectory_error(times, estimate, TIMES, LINE) == (0, 0)
    with pytest.raises(ValueError, match="no time in common"):
        trajectory_error(times[3:], estimate[3:], TIMES, LINE)
    with pytest.raises(ValueError, match="no time in common"):
        trajectory_error(times, estimate, [], np.zeros((0, 4, 4)))


def test_arguments_that_do_not_fit_are_errors():
    with pytest.raises(ValueError, match="align must be one of"):
        trajectory_error(TIMES, LINE, TIMES, LINE, align="best")
    with pytest.raises(ValueError, match="4 times for 5 poses"):
        trajectory_error(TIMES[:4], LINE, TIMES, LINE)


def test_map_error_is_the_mean_distance_to_the_nearest_reference_point():
    reference = np.array([[0, 0, 0], [10, 0, 0]])
    assert map_error(np.array([[0, 1, 0], [10, 0, 2], [9, 0, 0]]), reference) == pytest.approx(4 / 3)
    assert map_error(reference, np.vstack([reference, [[50, 50, 50]]])) == 0
    with pytest.raises(ValueError, match="a map without points"):
        map_error(np.zeros((0, 3)), reference)


def test_a_rebuilt_map_has_the_keyframes_at_the_given_poses():
    clouds = [make_cloud([[0.05, 0.05, 0.05]]), make_cloud([[1.05, 0.05, 0.05]])]
    keyframes = [Keyframe(i, float(i), pose(z=9), None, cloud, 1.0) for i, cloud in enumerate(clouds)]
    poses = [RigidTransform([0, 0, 0]), RigidTransform([0, 2, 0])]
    expected = [[0.05, 0.05, 0.05], [1.05, 2.05, 0.05]]
    for given in (poses, np.array([X.GetAsMatrix4() for X in poses])):
        points = rebuild_map(keyframes, given, 0.1).point.positions.numpy()
        np.testing.assert_allclose(points, expected, atol=1e-6)
    with pytest.raises(ValueError, match="1 poses for 2 keyframes"):
        rebuild_map(keyframes, poses[:1], 0.1)
