"""Sub-maps move with their anchors, and together make the map that the scans would make at their new poses."""

import numpy as np
import open3d as o3d
import pytest
from naraha.systems.voxel_map import FREE, OCCUPIED, SubmapCollection, SubmapConfig, VoxelMap
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform, RollPitchYaw
from scipy.spatial import KDTree

LIDAR = np.array([0.1, 0.0, 0.4])


def scan(X_WB, seed=0, count=6000):
    """What a LiDAR at `LIDAR` in the base sees of a room of 8 × 6 × 3 m, without noise, as a cloud in the base."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    low, high = np.array([-4.0, -3.0, 0.0]), np.array([4.0, 3.0, 3.0])
    start = X_WB.multiply(LIDAR)
    distance = np.where(direction > 0, (high - start) / direction, (low - start) / direction).min(axis=1)
    p_BP = X_WB.inverse().multiply((start + distance[:, None] * direction).T).T
    cloud = PointCloud(o3d.core.Tensor(p_BP.astype(np.float32)))
    on_floor = np.abs(X_WB.multiply(p_BP.T).T[:, 2]) < 1e-3
    p = np.where(on_floor[:, None], [0.9, 0.1], [0.1, 0.9]).astype(np.float32)
    cloud.point["class_probabilities"] = o3d.core.Tensor(p)
    cloud.point["nir"] = o3d.core.Tensor(p[:, :1].copy())
    return cloud


def drive(count=6):
    """Poses and scans on a curve through the room."""
    poses = [
        RigidTransform(RollPitchYaw(0.02, -0.03, 0.3 * k), [-2 + 0.8 * k, 0.2 * k - 1, 0.13]) for k in range(count)
    ]
    return [(k, X, scan(X, k)) for k, X in enumerate(poses)]


def collect(scans, config=None, moved=None):
    """Sub-maps of `scans`, each placed at its own pose, or at that of `moved`."""
    submaps = SubmapCollection(config)
    for k, X, cloud in scans:
        submaps = submaps.insert(k, cloud, X if moved is None else moved[k], LIDAR)
    return submaps


def insert_all(scans, moved=None):
    voxels = VoxelMap()
    for k, X, cloud in scans:
        voxels.insert_cloud(cloud, (X if moved is None else moved[k]).GetAsMatrix4(), LIDAR)
    return voxels


def turned(scans, turn=0.35):
    """New poses, all moved by one motion that is on no grid."""
    X = RigidTransform(RollPitchYaw(0.02, -0.015, turn), [0.733, -0.412, 0.057])
    return {k: X @ X_MB for k, X_MB, _ in scans}


def test_a_submap_is_closed_after_its_scans_or_its_distance():
    scans = drive(5)
    by_scans = collect(scans, SubmapConfig(scans=2, distance=100.0))
    assert [(s.anchor, s.scans) for s in by_scans.submaps] == [(0, 2), (2, 2), (4, 1)]
    by_distance = collect(scans, SubmapConfig(scans=100, distance=1.0))
    assert [(s.anchor, s.scans) for s in by_distance.submaps] == [(0, 2), (2, 2), (4, 1)]


def test_without_corrections_the_submaps_make_the_map_of_all_scans():
    scans = drive()
    direct = insert_all(scans)
    composed = collect(scans, SubmapConfig(scans=2)).compose()
    indices, log_odds = direct.known()
    centres = (indices + 0.5) * 0.1
    assert len(composed.known()[1]) == len(indices)
    assert np.isfinite(composed.log_odds(centres)).all()
    # Exactly the same where nothing was clamped: the sum of at most 6 steps in either order.
    low, high = direct.config.log_odds_steps()[2:]
    alone = (np.abs(log_odds) < 1.5) & (np.abs(composed.log_odds(centres)) < 1.5)
    same = np.isclose(composed.log_odds(centres), log_odds, atol=1e-5)
    assert same[alone].mean() > 0.99
    assert (composed.state(centres) == direct.state(centres)).mean() > 0.999
    assert composed.log_odds(centres).min() >= low
    assert composed.log_odds(centres).max() <= high


def test_classes_and_channels_are_composed_too():
    scans = drive(4)
    direct = insert_all(scans)
    composed = collect(scans, SubmapConfig(scans=1)).compose()
    centres = direct.occupied()
    np.testing.assert_allclose(composed.class_posterior(centres), direct.class_posterior(centres), atol=0.02)
    a, b = (m.to_cloud() for m in (direct, composed))
    np.testing.assert_array_equal(a.point.positions.numpy(), b.point.positions.numpy())
    np.testing.assert_allclose(a.point["nir"].numpy(), b.point["nir"].numpy(), atol=1e-5)


@pytest.mark.parametrize("scans_each", [1, 3])
def test_a_corrected_map_is_that_of_the_scans_at_their_new_poses(scans_each):
    scans = drive()
    moved = turned(scans)
    submaps = collect(scans, SubmapConfig(scans=scans_each, distance=100.0))
    composed = submaps.correct({s.anchor: moved[s.anchor] for s in submaps.submaps}).compose()
    direct = insert_all(scans, moved)
    a, b = direct.occupied(), composed.occupied()
    # Every voxel may move by two along each axis (`move_blocks`), hardly any does by more than one.
    for one, other in ((a, b), (b, a)):
        apart = np.round(KDTree(one).query(other, p=np.inf)[0] / 0.1).astype(int)
        assert apart.max() <= 2
        assert (apart > 1).mean() < 0.005
    # Away from surfaces, where a neighbour of all states is of the same state, it is the same.
    known = composed.known()[0]
    centres = (known + 0.5) * 0.1
    state = direct.state(centres)
    around = [direct.state(centres + 0.1 * np.array(o)) for o in np.argwhere(np.ones((3, 3, 3))) - 1]
    inside = (np.array(around) == FREE).all(axis=0)
    assert inside.mean() > 0.3
    assert (composed.state(centres)[inside] == state[inside]).mean() > 0.995


def test_classes_move_with_their_voxels():
    scans = drive(3)
    moved = turned(scans)
    submaps = collect(scans).correct(moved)
    cloud = submaps.compose().to_cloud()
    X_WM = scans[0][1] @ moved[0].inverse()
    height = X_WM.multiply(cloud.point.positions.numpy().T.astype(float))[2]
    label = cloud.point["label"].numpy().ravel()
    assert (label[height < 0.1] == 0).mean() > 0.9  # the floor is class 0
    assert (label[height > 0.4] == 1).all()


def test_a_shift_by_whole_voxels_loses_nothing():
    scans = drive(3)
    shift = RigidTransform([1.3, -0.7, 0.2])
    composed = collect(scans).correct({0: shift @ scans[0][1]}).compose()
    before, after = collect(scans).compose(), composed
    np.testing.assert_allclose(np.sort(after.known()[1]), np.sort(before.known()[1]))
    centres = before.occupied()
    assert (after.state(centres + shift.translation()) == OCCUPIED).all()
    assert len(after.occupied()) == len(centres)


def test_a_single_voxel_is_never_lost_however_it_is_turned():
    rng = np.random.default_rng(3)
    one = VoxelMap()
    one.set_voxels(np.array([[3, -2, 5]]), np.array([1.0], np.float32))
    for _ in range(200):
        X = RigidTransform(RollPitchYaw(*rng.uniform(-3, 3, 3)), rng.uniform(-1, 1, 3)).GetAsMatrix4()
        moved = VoxelMap()
        moved.merge(one, X)
        centre = X[:3, :3] @ one.occupied()[0] + X[:3, 3]
        assert len(moved.occupied()) > 0
        assert np.linalg.norm(moved.occupied() - centre, axis=1).max() <= 0.1 * np.sqrt(3) / 2 + 1e-9


def test_a_correction_smaller_than_the_least_shift_is_kept_for_later():
    scans = drive(2)
    submaps = collect(scans)
    small = submaps.correct({0: RigidTransform([0.01, 0, 0]) @ scans[0][1]})
    assert small.submaps[0] is submaps.submaps[0]
    larger = small.correct({0: RigidTransform([0.03, 0, 0]) @ scans[0][1]})
    np.testing.assert_allclose(larger.submaps[0].X_MF.translation(), [0.03, 0, 0], atol=1e-12)


def test_the_next_scan_goes_where_the_corrected_submap_is():
    scans = drive(4)
    moved = turned(scans)
    submaps = SubmapCollection(SubmapConfig(distance=100.0))
    for k, X, cloud in scans[:2]:
        submaps = submaps.insert(k, cloud, X, LIDAR)
    submaps = submaps.correct(moved)
    for k, _, cloud in scans[2:]:
        submaps = submaps.insert(k, cloud, moved[k], LIDAR)
    at_once = collect(scans, SubmapConfig(distance=100.0)).correct(moved)
    assert repr(submaps.compose())[:30] == repr(at_once.compose())[:30]
    a, b = submaps.compose(), at_once.compose()
    np.testing.assert_allclose(a.known()[1].sum(), b.known()[1].sum(), rtol=1e-3)
    assert len(submaps.submaps) == 1


def test_what_was_composed_before_changes_nothing_but_the_time():
    scans = drive(6)
    moved = turned(scans)
    config = SubmapConfig(scans=2)
    busy = SubmapCollection(config)
    for k, X, cloud in scans:
        busy = busy.insert(k, cloud, X, LIDAR)
        busy.compose()
    branch = busy.correct(moved)
    branch.compose()
    assert repr(busy.compose()) == repr(collect(scans, config).compose())
    assert repr(branch.compose()) == repr(collect(scans, config).correct(moved).compose())
    assert repr(busy.compose()) != repr(branch.compose())


def test_two_branches_do_not_write_into_each_other():
    scans = drive(4)
    stem = collect(scans[:2])
    before = repr(stem.compose())
    left, right = (stem.insert(k, cloud, X, LIDAR) for k, X, cloud in scans[2:])
    assert repr(stem.compose()) == before
    assert repr(left.compose()) == repr(collect(scans[:3]).compose())
    assert repr(right.compose()) == repr(collect([*scans[:2], scans[3]]).compose())


def test_maps_that_do_not_fit_are_not_merged():
    with pytest.raises(ValueError, match="voxel size"):
        VoxelMap().merge(VoxelMap(channels=("nir",)))
    with pytest.raises(ValueError, match="classes"):
        VoxelMap(classes=2).merge(VoxelMap(classes=3))


def test_an_empty_collection_makes_an_empty_map():
    assert len(SubmapCollection().compose().known()[1]) == 0
    assert len(SubmapCollection().correct({0: RigidTransform()}).submaps) == 0
