"""Registration: right on clouds that fit, and never silently wrong on clouds that do not."""

import numpy as np
import open3d as o3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from naraha.systems.slam import RegistrationConfig, constraint, estimate_normals, register
from naraha.systems.slam.motion import distance_and_angle
from naraha.systems.slam.registration import METHODS
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform

from .conftest import make_cloud, pose, room_points, room_scan


@pytest.fixture(scope="module")
def room():
    return make_cloud(room_points(np.random.default_rng(0), 20000))


def error(X_TS, X_true):
    return distance_and_angle(X_true.inverse() @ X_TS)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_finds_the_pose_of_a_scan_in_the_room(method, room):
    X_WS = pose(1.0, -0.5, 1.2, 0.05, -0.03, 0.8)
    scan = make_cloud(room_scan(np.random.default_rng(1), X_WS))
    guess = X_WS @ pose(0.25, -0.2, 0.1, 0.02, 0.03, 0.12)
    result = register(scan, room, guess, RegistrationConfig(method=method))
    assert result.valid, result.reason
    distance, angle = error(result.X_TS, X_WS)
    assert distance < (0.02 if method == "point_to_plane" else 0.06)
    assert angle < 0.01
    assert result.fitness > 0.95
    assert result.inliers > 1000
    assert 0 < result.inlier_rmse < 0.2
    assert 0.5 < result.health <= 1
    assert result.reason == ""


@pytest.mark.parametrize("kernel", ["tukey", "geman_mcclure"])
def test_a_robust_kernel_ignores_what_was_not_there_before(kernel, room):
    """A wall of boxes stands where the target has nothing; the plain loss is pulled by it."""
    rng = np.random.default_rng(2)
    X_WS = pose(0.5, 0.5, 1.0, 0, 0, 0.3)
    new = X_WS.inverse().multiply(rng.uniform([-4.7, -3, 0], [-4.4, 3, 2.5], (1500, 3)).T).T
    scan = make_cloud(np.vstack([room_scan(rng, X_WS), new]))
    guess = X_WS @ pose(0.1, 0.1, 0.0, yaw=0.05)
    robust = register(scan, room, guess, RegistrationConfig(kernel=kernel, kernel_scale=0.2))
    plain = register(scan, room, guess, RegistrationConfig(kernel="none"))
    assert robust.valid
    assert error(robust.X_TS, X_WS)[0] < 0.03
    assert error(robust.X_TS, X_WS)[0] < 0.5 * error(plain.X_TS, X_WS)[0]


def test_turns_of_the_guess_find_a_scan_that_was_turned_far(room):
    X_WS = pose(1.0, -0.5, 1.2, yaw=0.9)
    scan = make_cloud(room_scan(np.random.default_rng(3), X_WS))
    guess = X_WS @ pose(z=0, yaw=np.deg2rad(48))
    narrow = [0.6, 0.3]
    without = register(scan, room, guess, RegistrationConfig(max_distances=narrow, retry_yaws_deg=[]))
    assert not without.valid or error(without.X_TS, X_WS)[0] > 0.1
    found = register(scan, room, guess, RegistrationConfig(max_distances=narrow))
    assert found.valid, found.reason
    assert error(found.X_TS, X_WS)[0] < 0.02


def corridor(rng, count, length=30.0):
    x, u = rng.uniform(-length / 2, length / 2, count), rng.uniform(-1.2, 1.2, count)
    side, sign = rng.integers(0, 2, count), rng.choice([-1.2, 1.2], count)
    return np.stack([x, np.where(side, sign, u), np.where(side, u, sign)], axis=1)


REJECTED = {
    "empty": (lambda rng, scan: np.zeros((0, 3)), "source has 0 usable points"),
    "tiny": (lambda rng, scan: scan[:50], "source has 50 usable points"),
    "NaN": (lambda rng, scan: np.full((500, 3), np.nan), "source has 0 usable points"),
    "one place": (lambda rng, scan: np.tile(scan[:1], (500, 1)), "source covers 1 voxels"),
    "elsewhere": (lambda rng, scan: scan + 100, "no overlap"),
    "noise": (lambda rng, scan: rng.uniform(-30, 30, (4000, 3)), "no overlap|too little overlap|jump"),
}


@pytest.mark.parametrize("case", REJECTED)
def test_a_source_that_cannot_be_placed_gives_the_guess_and_says_why(case, room):
    rng = np.random.default_rng(4)
    make, reason = REJECTED[case]
    guess = pose(0.5, 0.4, 1.0)
    result = register(make_cloud(make(rng, room_scan(rng, guess))), room, guess)
    assert not result.valid
    assert result.health == 0
    assert result.X_TS.IsExactlyEqualTo(guess)
    assert any(part in result.reason for part in reason.split("|"))


def test_a_target_or_guess_that_cannot_be_used_says_so(room):
    assert register(room, PointCloud(), RigidTransform()).reason == "target has 0 usable points, needs 100"
    assert register(PointCloud(), room, RigidTransform()).reason == "source has 0 usable points, needs 100"
    broken = RigidTransform([np.nan, 0, 0])
    result = register(room, room, broken)
    assert result.reason == "the guess is not finite"
    assert np.isfinite(result.X_TS.GetAsMatrix4()).all()


def test_points_that_are_not_finite_do_not_disturb_the_others(room):
    rng = np.random.default_rng(5)
    X_WS = pose(0.5, 0.4, 1.0, yaw=0.2)
    scan = room_scan(rng, X_WS)
    scan[::7, 1] = np.nan
    scan[::11, 2] = np.inf
    result = register(make_cloud(scan), room, X_WS @ pose(0.1, 0.0, 0.0))
    assert result.valid
    assert error(result.X_TS, X_WS)[0] < 0.02


def test_a_corridor_that_does_not_hold_the_way_along_it_is_not_valid():
    rng = np.random.default_rng(6)
    result = register(make_cloud(corridor(rng, 5000)), make_cloud(corridor(rng, 20000)), RigidTransform([0.3, 0.1, 0]))
    assert not result.valid
    assert "does not hold x" in result.reason


def test_a_correction_larger_than_allowed_is_a_jump(room):
    X_WS = pose(0.5, 0.4, 1.0, yaw=0.2)
    scan = make_cloud(room_scan(np.random.default_rng(7), X_WS))
    guess = X_WS @ pose(0.4, 0.0, 0.0)
    assert register(scan, room, guess, RegistrationConfig(max_correction=0.5)).valid
    far = register(scan, room, guess, RegistrationConfig(max_correction=0.3))
    assert not far.valid
    assert far.reason.startswith("jump of 0.4")
    assert far.X_TS.IsExactlyEqualTo(guess)
    turned = register(scan, room, X_WS @ pose(z=0, yaw=0.2), RegistrationConfig(max_correction_deg=5.0))
    assert "11 deg" in turned.reason


@settings(max_examples=15)
@given(seed=st.integers(0, 1000), dx=st.floats(-0.3, 0.3), dy=st.floats(-0.3, 0.3), yaw=st.floats(-0.15, 0.15))
def test_from_any_near_guess_the_result_is_right_or_not_valid(seed, dx, dy, yaw):
    rng = np.random.default_rng(seed)
    target = make_cloud(room_points(np.random.default_rng(0), 20000))
    X_WS = pose(rng.uniform(-1, 1), rng.uniform(-1, 1), 1.0, yaw=rng.uniform(-3, 3))
    result = register(make_cloud(room_scan(rng, X_WS, 3000)), target, X_WS @ pose(dx, dy, 0, yaw=yaw))
    assert not result.valid or error(result.X_TS, X_WS)[0] < 0.05


def test_the_same_clouds_give_the_same_bits(room):
    """Open3D's threads add in any order; the result is rounded so that it does not show."""
    X_WS = pose(1.0, -0.5, 1.2, 0.05, -0.03, 0.8)
    scan = make_cloud(room_scan(np.random.default_rng(1), X_WS))
    for method in METHODS:
        config = RegistrationConfig(method=method)
        results = [register(scan, room, X_WS @ pose(0.2, 0.1, 0.0), config) for _ in range(8)]
        assert len({result.X_TS.GetAsMatrix4().tobytes() for result in results}) == 1
        assert len({(result.fitness, result.inlier_rmse, result.health) for result in results}) == 1


def test_the_constraint_of_a_cube_is_the_one_by_hand():
    """Points on the faces of a cube: any shift is felt by one pair of faces out of three."""
    rng = np.random.default_rng(8)
    count = 60000
    points, axis = rng.uniform(-1, 1, (count, 3)), rng.integers(0, 3, count)
    points[np.arange(count), axis] = rng.choice([-1, 1], count)
    normals = np.eye(3)[axis]
    values, motions = constraint(points, normals)
    # A turn about an axis: a third of the points moves in the plane of its face and is not felt; the others move by
    # |d|² = 1 + u² and are felt by u²: (2/3 · 1/3) / (2/3 · 4/3 + 1/3 · 2/3) = 1/5.
    np.testing.assert_allclose(values, [0.2, 0.2, 0.2, 1 / 3, 1 / 3, 1 / 3], atol=0.01)
    assert np.abs(motions[:3, :3]).max() > 10 * np.abs(motions[3:, :3]).max()


@pytest.mark.parametrize(("scale", "shift"), [(1.0, 0.0), (50.0, 0.0), (1.0, 1000.0)])
def test_the_constraint_has_no_unit_and_no_origin(scale, shift):
    rng = np.random.default_rng(9)
    points = corridor(rng, 4000)
    normals = np.where(np.abs(points) == 1.2, 1.0, 0.0)
    values, motions = constraint(scale * points + shift, normals)
    np.testing.assert_allclose(values, constraint(points, normals)[0], atol=1e-6)
    assert values[0] < 1e-6
    assert np.abs(motions[3, 0]) > 0.99


def test_normals_of_a_tilted_plane_are_its_own():
    rng = np.random.default_rng(10)
    xy = rng.uniform(-2, 2, (3000, 2))
    points = np.column_stack([xy, 0.5 * xy[:, 0]])
    expected = np.array([-0.5, 0, 1]) / np.sqrt(1.25)
    np.testing.assert_allclose(np.abs(estimate_normals(points, 0.5) @ expected), 1, atol=1e-9)


def test_registration_prints_nothing(room, capfd):
    register(make_cloud(np.random.default_rng(0).uniform(-1, 1, (300, 3))), room, RigidTransform([50, 0, 0]))
    assert o3d.utility.get_verbosity_level() != o3d.utility.VerbosityLevel.Error
    printed = capfd.readouterr()
    assert printed.out == printed.err == ""
