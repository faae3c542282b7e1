"""Registration: right on clouds that fit, and never silently wrong on clouds that do not."""

import copy

import numpy as np
import open3d as o3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from naraha.systems.clouds import estimate_normals, voxel_filter
from naraha.systems.config import check_config
from naraha.systems.errors import ConfigError
from naraha.systems.registration import (
    METHODS,
    IcpConfig,
    RegistrationConfig,
    SurfacesConfig,
    covariance_at,
    prepare_target,
    register,
)
from naraha.systems.slam.motion import distance_and_angle
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform, RollPitchYaw

from tests.rooms import NOISE, corridor, make_cloud, pose, room_points, room_scan


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
    assert distance < {"surfaces": 0.004, "point_to_plane": 0.02}.get(method, 0.06)
    assert angle < (0.001 if method == "surfaces" else 0.01)
    assert result.fitness > 0.95
    assert result.inliers > 1000
    assert 0 < result.inlier_rmse < 0.2
    assert 0.5 < result.health <= 1
    assert result.reason == ""
    assert [axis.fixed_by for axis in result.axes] == ["geometry"] * 6
    assert np.linalg.eigvalsh(result.covariance).min() > 0
    assert np.sqrt(np.trace(result.covariance[3:, 3:])) < 0.05


@pytest.mark.parametrize("kernel", ["tukey", "geman_mcclure"])
def test_a_robust_kernel_ignores_what_was_not_there_before(kernel, room):
    """A wall of boxes stands where the target has nothing; the plain loss is pulled by it."""
    rng = np.random.default_rng(2)
    X_WS = pose(0.5, 0.5, 1.0, 0, 0, 0.3)
    new = X_WS.inverse().multiply(rng.uniform([-4.7, -3, 0], [-4.4, 3, 2.5], (1500, 3)).T).T
    scan = make_cloud(np.vstack([room_scan(rng, X_WS), new]))
    guess = X_WS @ pose(0.1, 0.1, 0.0, yaw=0.05)
    scale = {"tukey": 0.2, "geman_mcclure": 0.1}[kernel]  # Geman-McClure has the longer tail
    robust = register(
        scan, room, guess, RegistrationConfig(method="point_to_plane", icp=IcpConfig(kernel=kernel, kernel_scale=scale))
    )
    plain = register(scan, room, guess, RegistrationConfig(method="point_to_plane", icp=IcpConfig(kernel="none")))
    assert robust.valid
    assert error(robust.X_TS, X_WS)[0] < 0.03
    assert error(robust.X_TS, X_WS)[0] < 0.5 * error(plain.X_TS, X_WS)[0]


def test_turns_of_the_guess_find_a_scan_that_was_turned_far(room):
    X_WS = pose(1.0, -0.5, 1.2, yaw=0.9)
    scan = make_cloud(room_scan(np.random.default_rng(3), X_WS))
    guess = X_WS @ pose(z=0, yaw=np.deg2rad(48))
    narrow = SurfacesConfig(first_width=0.3, first_reach=0.5)
    without = register(scan, room, guess, RegistrationConfig(surfaces=narrow, retry_yaws_deg=[]))
    assert not without.valid or error(without.X_TS, X_WS)[1] > 0.3
    found = register(scan, room, guess, RegistrationConfig(surfaces=narrow))
    assert found.valid, found.reason
    assert error(found.X_TS, X_WS)[0] < 0.02


REJECTED = {
    "empty": (lambda rng, scan: np.zeros((0, 3)), "source has 0 usable points"),
    "tiny": (lambda rng, scan: scan[:50], "source has 50 usable points"),
    "NaN": (lambda rng, scan: np.full((500, 3), np.nan), "source has 0 usable points"),
    "one place": (lambda rng, scan: np.tile(scan[:1], (500, 1)), "source has 0 surfels, needs 40"),
    "elsewhere": (lambda rng, scan: scan + 100, "no overlap"),
    "noise": (lambda rng, scan: rng.uniform(-30, 30, (4000, 3)), "source has|no overlap|too little overlap|jump"),
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


def test_along_a_corridor_the_guess_is_kept_and_the_rest_is_corrected():
    rng = np.random.default_rng(6)
    guess = pose(0.3, 0.1, -0.05, 0.02, 0.01, -0.03)
    result = register(make_cloud(corridor(rng, 5000)), make_cloud(corridor(rng, 20000)), guess)
    assert result.valid
    assert result.reason == "the geometry does not hold x: taken from the guess"
    assert result.health < 0.1
    x, y, z = result.X_TS.translation()
    assert x == pytest.approx(0.3, abs=0.01)
    assert np.abs([y, z]).max() < 0.01
    assert distance_and_angle(result.X_TS)[1] < 0.002


def test_on_an_open_plane_only_height_and_tilt_are_corrected():
    rng = np.random.default_rng(6)
    planes = [np.column_stack([rng.uniform(-8, 8, (count, 2)), np.zeros(count)]) for count in (5000, 20000)]
    result = register(*map(make_cloud, planes), pose(0.3, -0.2, 0.1, 0.02, 0.01, 0.05))
    assert result.reason == "the geometry does not hold x, y, yaw: taken from the guess"
    assert result.health < 0.01
    np.testing.assert_allclose(result.X_TS.translation(), [0.3, -0.2, 0], atol=0.005)
    rpy = RollPitchYaw(result.X_TS.rotation()).vector()
    np.testing.assert_allclose(rpy, [0, 0, 0.05], atol=1e-3)


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


@pytest.mark.parametrize("method", METHODS)
def test_a_prepared_target_gives_what_the_cloud_itself_gives(method, room):
    config = RegistrationConfig(method=method)
    X_WS = pose(0.5, 0.4, 1.0, yaw=0.2)
    scan = make_cloud(room_scan(np.random.default_rng(8), X_WS))
    guess = X_WS @ pose(0.1, 0.05, 0.0)
    prepared = register(scan, prepare_target(room, config), guess, config)
    assert prepared.X_TS.IsExactlyEqualTo(register(scan, room, guess, config).X_TS)
    assert copy.deepcopy(prepared) is prepared


def test_a_target_prepared_for_another_method_is_refused(room):
    target = prepare_target(room, RegistrationConfig(method="point_to_plane"))
    result = register(room, target, RigidTransform())
    assert result.reason == "the target was prepared for point_to_plane, not for surfaces"
    assert copy.deepcopy(target) is target


@pytest.mark.parametrize("covariance", [np.zeros((6, 6)), -np.eye(6), np.full((6, 6), np.nan), np.eye(3)])
def test_what_is_no_covariance_is_refused(covariance, room):
    result = register(room, room, RigidTransform(), guess_covariance=covariance)
    assert not result.valid
    assert result.reason == "the covariance of the guess is not positive definite"


def test_identical_clouds_lie_where_they_are(room):
    for method in METHODS:
        result = register(room, room, RigidTransform(), RegistrationConfig(method=method))
        assert result.valid
        # Open3D's source is thinned to means, which are not the target's points.
        assert result.X_TS.IsNearlyEqualTo(RigidTransform(), 1e-4 if method == "surfaces" else 0.03)
        assert np.isfinite(result.covariance).all()


def test_lists_without_entries_are_refused_by_the_check_of_configurations():
    with pytest.raises(
        ConfigError, match=r"icp.max_distances: must not be empty, got \[\] .valid: at least 1, each > 0 m"
    ):
        check_config(RegistrationConfig(icp=IcpConfig(max_distances=[])))
    check_config(RegistrationConfig(retry_yaws_deg=[]))


def test_the_same_clouds_give_the_same_bits(room):
    """Open3D's threads add in any order; the result is rounded so that it does not show."""
    X_WS = pose(1.0, -0.5, 1.2, 0.05, -0.03, 0.8)
    scan = make_cloud(room_scan(np.random.default_rng(1), X_WS))
    for method in METHODS:
        config = RegistrationConfig(method=method)
        results = [register(scan, room, X_WS @ pose(0.2, 0.1, 0.0), config) for _ in range(8)]
        assert len({result.X_TS.GetAsMatrix4().tobytes() for result in results}) == 1
        assert len({(result.fitness, result.inlier_rmse, result.health) for result in results}) == 1


def test_normals_of_a_tilted_plane_are_its_own():
    rng = np.random.default_rng(10)
    xy = rng.uniform(-2, 2, (3000, 2))
    points = np.column_stack([xy, 0.5 * xy[:, 0]])
    expected = np.array([-0.5, 0, 1]) / np.sqrt(1.25)
    np.testing.assert_allclose(np.abs(estimate_normals(points, 0.5) @ expected), 1, atol=1e-9)


def test_there_are_no_normals_on_lines_and_edges_and_in_clutter():
    rng = np.random.default_rng(11)
    line = np.column_stack([np.linspace(0, 10, 200), rng.normal(0, NOISE, (200, 2))])
    assert not estimate_normals(line, 0.75).any()
    clutter = rng.uniform(-1, 1, (2000, 3))
    assert estimate_normals(clutter, 0.5).any(axis=1).mean() < 0.05
    x, u, on_floor = rng.uniform(0, 6, 6000), rng.uniform(0, 2, 6000), rng.random(6000) < 0.5
    floor_and_wall = np.column_stack([x, np.where(on_floor, u, 0), np.where(on_floor, 0, u)])
    normals = estimate_normals(floor_and_wall, 0.3)
    edge, away = u < 0.03, u > 0.4
    assert normals[edge].any(axis=1).mean() < 0.1
    np.testing.assert_allclose(np.abs(normals[away & on_floor, 2]), 1, atol=1e-9)
    np.testing.assert_allclose(np.abs(normals[away & ~on_floor, 1]), 1, atol=1e-9)


def test_the_foot_of_a_wall_does_not_lift_the_robot():
    """Where floor and wall share a voxel their mean point is above the floor; without a ceiling nothing pushes back."""
    rng = np.random.default_rng(12)

    def trench(count):
        points = corridor(rng, count, length=12.0)
        points[:, 2] = np.where(points[:, 2] == 1.2, -1.2, points[:, 2])  # the ceiling is folded onto the floor
        ends = rng.uniform([-6, -1.2, -1.2], [6, 1.2, 1.2], (count // 10, 3))
        ends[:, 0] = np.sign(ends[:, 0]) * 6
        return np.vstack([points, ends]) + rng.normal(0, NOISE, (count + count // 10, 3))

    target = voxel_filter(make_cloud(trench(40000)), 0.25)
    heights = []
    for _ in range(5):
        result = register(make_cloud(trench(8000)), target, pose(z=0))
        assert result.valid
        heights.append(result.X_TS.translation()[2])
    assert np.abs(heights).mean() < 0.004


def test_registration_prints_nothing(room, capfd):
    register(make_cloud(np.random.default_rng(0).uniform(-1, 1, (300, 3))), room, RigidTransform([50, 0, 0]))
    assert o3d.utility.get_verbosity_level() != o3d.utility.VerbosityLevel.Error
    printed = capfd.readouterr()
    assert printed.out == printed.err == ""


def test_the_covariance_of_another_point_of_a_body_is_that_of_how_it_moves():
    rng = np.random.default_rng(0)
    A = rng.normal(0, 0.002, (6, 6))
    covariance, lever = A @ A.T, np.array([0.4, -1.2, 3.0])
    moves = rng.multivariate_normal(np.zeros(6), covariance, 200_000)
    there = np.hstack([moves[:, :3], moves[:, 3:] + np.cross(moves[:, :3], lever)])
    np.testing.assert_allclose(covariance_at(covariance, lever), np.cov(there.T), atol=0.02 * np.cov(there.T).max())
    np.testing.assert_allclose(covariance_at(covariance_at(covariance, lever), -lever), covariance, atol=1e-15)


def test_a_result_can_be_told_for_another_frame_of_the_same_body(room):
    X_WS, X_SB = pose(0.5, 0.4, 1.0, yaw=0.2), pose(0.2, 0.1, -0.5, pitch=0.1)
    result = register(make_cloud(room_scan(np.random.default_rng(8), X_WS)), room, X_WS)
    of_base = result.at(X_SB)
    assert error(of_base.X_TS, X_WS @ X_SB)[0] < 0.006
    assert of_base.X_TS.IsNearlyEqualTo(result.X_TS @ X_SB, 1e-12)
    assert np.linalg.eigvalsh(of_base.covariance).min() > 0
    failed = register(make_cloud(np.zeros((0, 3))), room, X_WS).at(X_SB)
    assert not failed.valid
    assert failed.X_TS.IsNearlyEqualTo(X_WS @ X_SB, 1e-12)
