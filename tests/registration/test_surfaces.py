"""Our registration: exact on scans that fit, right about what it does not know, never healthy where it is wrong."""

import numpy as np
import open3d as o3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from naraha.systems.clouds import VoxelCloud, transform_points
from naraha.systems.registration import RegistrationConfig, SurfacesConfig, prepare_target, register
from naraha.systems.slam.motion import distance_and_angle
from pydrake.math import RigidTransform

from tests.registration.scans import CORRIDOR, ROOM, scan, with_classes
from tests.rooms import make_cloud, pose

X_WT = pose(0.6, 0.4, 1.0, yaw=0.4)
X_TS = pose(0.35, -0.3, 0.0, 0.015, -0.01, 0.17)
X_WC = pose(0.0, 0.1, 1.0, yaw=0.02)
ALONG = pose(0.5, 0.02, 0.0, yaw=0.02)


def error(result, X_true):
    return distance_and_angle(X_true.inverse() @ result.X_TS)


def pair(boxes, X_WT, X_TS, seed=0, **kwargs):
    """Source and target."""
    rng = np.random.default_rng(seed)
    target = scan(boxes, X_WT, rng, **kwargs)
    return scan(boxes, X_WT @ X_TS, rng, **kwargs), target


@pytest.mark.parametrize("organised", [True, False])
def test_two_scans_of_a_room_are_laid_on_each_other_within_millimetres(organised):
    source, target = pair(ROOM, X_WT, X_TS, organised=organised)
    result = register(source, target, RigidTransform())
    assert result.valid
    assert result.reason == ""
    distance, angle = error(result, X_TS)
    assert distance < 0.006
    assert angle < np.deg2rad(0.08)
    assert result.fitness > 0.9
    assert [axis.fixed_by for axis in result.axes] == ["geometry"] * 6
    assert all(0.0001 < axis.deviation < 0.01 for axis in result.axes)


def test_a_scan_with_rings_is_laid_on_a_map_without():
    rng = np.random.default_rng(1)
    voxels = VoxelCloud(0.1)
    for _ in range(8):
        X_WS = pose(rng.uniform(-2, 1), rng.uniform(-1, 1), 1.0, yaw=rng.uniform(-3, 3))
        voxels = voxels.insert(scan(ROOM, X_WS, rng, organised=False), X_WS.GetAsMatrix4())
    config = RegistrationConfig()
    target = prepare_target(voxels.to_cloud(), config)
    for organised in (True, False):
        source = scan(ROOM, X_WT, rng, organised=organised)
        result = register(source, target, X_WT @ pose(0.2, -0.1, 0.02, yaw=0.1), config)
        assert result.valid
        assert error(result, X_WT)[0] < 0.015
        assert error(result, X_WT)[1] < 0.003


@settings(max_examples=12)
@given(seed=st.integers(0, 1000), x=st.floats(-0.4, 0.4), y=st.floats(-0.4, 0.4), yaw=st.floats(-0.2, 0.2))
def test_from_any_near_guess_the_result_is_the_same(seed, x, y, yaw):
    """The answer is that of the clouds, not of the guess."""
    source, target = pair(ROOM, X_WT, X_TS, seed)
    there = register(source, target, X_TS)
    result = register(source, target, X_TS @ pose(x, y, 0, yaw=yaw))
    assert result.valid
    assert error(result, there.X_TS)[0] < 1e-3


def test_a_cloud_in_another_frame_gives_the_same_pose_in_that_frame():
    source, target = pair(ROOM, X_WT, X_TS, organised=False)
    X_AT = pose(100.0, -50.0, 3.0, 0.5, -0.4, 2.0)
    moved = make_cloud(transform_points(X_AT.GetAsMatrix4(), target.point.positions.numpy().astype(float)))
    result = register(source, moved, X_AT)
    assert result.valid
    assert error(result, X_AT @ X_TS)[0] < 0.01


def test_along_a_corridor_the_guess_stays_and_everything_else_is_corrected():
    source, target = pair(CORRIDOR, X_WC, ALONG, max_range=12)
    for x in (0.0, 0.4):
        result = register(source, target, pose(x, 0.1, 0.05, yaw=-0.05))
        assert result.valid
        assert result.reason == "the geometry does not hold x: taken from the guess"
        assert result.health < 0.05
        assert [axis.fixed_by for axis in result.axes] == ["guess"] + ["geometry"] * 5
        assert abs(result.axes[0].motion[3]) > 0.99
        assert result.axes[0].deviation == pytest.approx(0.5)
        assert np.sqrt(result.covariance[3, 3]) > 0.3
        moved = X_WC.rotation() @ (result.X_TS.translation() - ALONG.translation())
        assert moved[0] == pytest.approx(x - 0.5, abs=0.02)  # never zero motion where the guess has moved
        assert np.abs(moved[1:]).max() < 0.005
        assert (ALONG.rotation().inverse() @ result.X_TS.rotation()).ToAngleAxis().angle() < 0.001


@pytest.mark.parametrize("wrong", [0.0, 0.2])
def test_along_a_corridor_classes_say_how_far(wrong):
    source, target = pair(CORRIDOR, X_WC, ALONG, max_range=12)
    rng = np.random.default_rng(3)
    with_classes(target, X_WC, rng, wrong=wrong)
    with_classes(source, X_WC @ ALONG, rng, wrong=wrong)
    for x in (0.0, 0.4):
        result = register(source, target, pose(x, 0.0, 0.0))
        assert result.reason == "the geometry does not hold x: taken from the classes"
        assert result.axes[0].fixed_by == "classes"
        assert abs(result.X_TS.translation()[0] - 0.5) < min(0.05, 4 * result.axes[0].deviation)
        assert result.axes[0].deviation < 0.1
        assert result.health > 0.2


def test_classes_that_say_nothing_leave_it_to_the_guess():
    source, target = pair(CORRIDOR, X_WC, ALONG, max_range=12)
    rng = np.random.default_rng(4)
    for cloud in (source, target):
        noise = rng.uniform(0.3, 0.7, len(cloud.point.positions)).astype(np.float32)
        cloud.point["class_probabilities"] = o3d.core.Tensor(np.column_stack([noise, 1 - noise]))
    result = register(source, target, pose(0.4, 0.0, 0.0))
    assert result.reason == "the geometry does not hold x: taken from the guess"
    assert result.X_TS.translation()[0] == pytest.approx(0.4, abs=0.02)


def test_classes_keep_partners_apart_that_geometry_would_join():
    """A floor of two colours, each shifted in height by itself: what is of one colour is laid on what is of it."""
    rng = np.random.default_rng(5)
    xy = rng.uniform(-6, 6, (20000, 2))
    red = xy[:, 0] > 0
    box = np.column_stack([xy, 0.05 * ~red])
    flat = np.column_stack([xy, np.zeros(len(xy))])
    target, source = make_cloud(np.vstack([flat, box + np.array([0, 0, 0.2])])), make_cloud(flat)
    layers = np.concatenate([np.zeros(len(xy), int), np.ones(len(xy), int)])
    target.point["class_probabilities"] = o3d.core.Tensor(np.eye(2, dtype=np.float32)[layers])
    source.point["class_probabilities"] = o3d.core.Tensor(np.eye(2, dtype=np.float32)[np.zeros(len(xy), int)])
    heights = []
    for classes in (True, False):
        surfaces = SurfacesConfig(classes=classes, first_width=0.4, radius=0.15, last_width=0.3)
        result = register(source, target, pose(z=0.12), RegistrationConfig(surfaces=surfaces))
        heights.append(result.X_TS.translation()[2])
    assert abs(heights[0]) < 0.02
    assert abs(heights[0]) < 0.5 * abs(heights[1])


def test_points_whose_class_is_not_known_count_as_those_of_clouds_without():
    source, target = pair(ROOM, X_WT, X_TS)
    without = register(source, target, RigidTransform())
    for cloud in (source, target):
        unknown = np.full((len(cloud.point.positions), 3), np.nan, np.float32)
        cloud.point["class_probabilities"] = o3d.core.Tensor(unknown)
    assert register(source, target, RigidTransform()).X_TS.IsExactlyEqualTo(without.X_TS)


def test_other_numbers_of_classes_are_not_compared():
    source, target = pair(CORRIDOR, X_WC, ALONG, max_range=12)
    for cloud, count in ((source, 2), (target, 3)):
        even = np.full((len(cloud.point.positions), count), 1 / count, np.float32)
        cloud.point["class_probabilities"] = o3d.core.Tensor(even)
    assert register(source, target, pose(0.4, z=0)).reason == "the geometry does not hold x: taken from the guess"


@pytest.mark.parametrize("axis", [0, 1])
def test_a_mirrored_scan_is_contradicted_by_what_was_seen_through(axis):
    source, target = pair(ROOM, X_WT, X_TS)
    points = source.point.positions.numpy().copy()
    points[:, axis] *= -1
    source.point.positions = o3d.core.Tensor(points)
    result = register(source, target, RigidTransform())
    assert not result.valid
    assert result.health == 0
    assert "seen through" in result.reason


def test_another_place_is_no_overlap_or_contradicted():
    rng = np.random.default_rng(6)
    other = [([0, 0, 1.5], [6, 14, 3], 0.3), ([1, 3, 1], [1, 1, 2], 0.8), ([-1.5, -3, 1], [1, 2, 2], 0.2)]
    source = scan(other, pose(0.2, 0.1, 1.0), rng)
    for organised in (True, False):
        result = register(source, scan(ROOM, X_WT, rng, organised=organised), RigidTransform())
        assert not result.valid
        assert result.X_TS.IsExactlyEqualTo(RigidTransform())


def test_a_wood_is_laid_on_itself_though_it_has_no_planes():
    """Trunks of branches: what makes no plane is clutter, and the nearest of it is as good as it gets."""
    rng = np.random.default_rng(7)
    trees = rng.uniform(-12, 12, (60, 2))
    branches = np.vstack([np.column_stack([rng.normal(t, 0.4, (250, 2)), rng.uniform(0.5, 5, 250)]) for t in trees])
    ground = np.column_stack([rng.uniform(-14, 14, (6000, 2)), np.zeros(6000)])
    X_true = pose(0.3, -0.2, 0.0, yaw=0.08)
    target = make_cloud(np.vstack([branches, ground]))
    moved = X_true.inverse().multiply(np.vstack([branches, rng.permutation(ground)]).T).T
    source = make_cloud(moved[rng.random(len(moved)) < 0.7] + rng.normal(0, 0.01, (1, 3)))
    result = register(source, target, RigidTransform())
    assert result.valid
    assert error(result, X_true)[0] < 0.03
    assert error(result, X_true)[1] < 0.005


def test_the_same_scans_give_the_same_bits():
    source, target = pair(ROOM, X_WT, X_TS)
    first, second = (register(source, target, RigidTransform()) for _ in range(2))
    assert first.X_TS.GetAsMatrix4().tobytes() == second.X_TS.GetAsMatrix4().tobytes()
    assert first.covariance.tobytes() == second.covariance.tobytes()
    assert (first.health, first.fitness, first.inlier_rmse) == (second.health, second.fitness, second.inlier_rmse)


def test_the_clouds_are_left_as_they_were():
    source, target = pair(ROOM, X_WT, X_TS)
    before = [cloud.point.positions.numpy().copy() for cloud in (source, target)]
    register(source, target, RigidTransform())
    for cloud, points in zip((source, target), before, strict=True):
        np.testing.assert_array_equal(cloud.point.positions.numpy(), points)
