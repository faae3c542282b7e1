"""Voxel clouds: means that do not depend on how the points arrived."""

import copy

import numpy as np
import open3d as o3d
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.clouds import VoxelCloud, voxel_filter
from open3d.t.geometry import PointCloud


def make_cloud(points, **attributes):
    cloud = PointCloud(o3d.core.Tensor(np.asarray(points, np.float32).reshape(-1, 3)))
    for name, values in attributes.items():
        values = np.asarray(values)
        cloud.point[name] = o3d.core.Tensor(values if values.ndim > 1 else values[:, None])
    return cloud


def as_dict(cloud, voxel):
    """{voxel indices: (mean, count)}"""
    points = cloud.point.positions.numpy().astype(float)
    count = cloud.point["count"].numpy()[:, 0]
    return {tuple(np.floor(p / voxel).astype(int)): (p, n) for p, n in zip(points, count, strict=True)}


def test_two_voxels_have_the_means_by_hand():
    cloud = make_cloud(
        [[0.1, 0.1, 0.1], [0.3, 0.5, 0.7], [-0.1, 0.2, 0.2]],
        intensity=np.float32([1, 3, 5]),
        near_ir=np.uint16([7, 8, 9]),
    )
    filtered = voxel_filter(cloud, 1.0)
    np.testing.assert_allclose(filtered.point.positions.numpy(), [[-0.1, 0.2, 0.2], [0.2, 0.3, 0.4]], atol=1e-7)
    np.testing.assert_allclose(filtered.point["intensity"].numpy(), [[5], [2]])
    np.testing.assert_allclose(filtered.point["near_ir"].numpy(), [[9], [7.5]])
    assert filtered.point["near_ir"].dtype == o3d.core.float32
    np.testing.assert_array_equal(filtered.point["count"].numpy(), [[1], [2]])


@given(seed=st.integers(0, 10_000), cuts=st.lists(st.integers(0, 300), max_size=8), voxel=st.floats(0.05, 2.0))
def test_the_order_and_grouping_of_insertions_do_not_matter(seed, cuts, voxel):
    rng = np.random.default_rng(seed)
    points = rng.normal(0, 1, (300, 3)).astype(np.float32)
    values = rng.random((300, 2)).astype(np.float32)
    at_once = VoxelCloud(voxel).insert(make_cloud(points, colour=values)).to_cloud()
    order = rng.permutation(300)
    grown = VoxelCloud(voxel)
    for part in np.split(order, sorted(cuts)):
        grown = grown.insert(make_cloud(points[part], colour=values[part]))
    grown = grown.to_cloud()
    np.testing.assert_array_equal(grown.point["count"].numpy(), at_once.point["count"].numpy())
    np.testing.assert_allclose(grown.point.positions.numpy(), at_once.point.positions.numpy(), atol=1e-6)
    np.testing.assert_allclose(grown.point["colour"].numpy(), at_once.point["colour"].numpy(), atol=1e-6)


def test_every_point_counts_once_and_in_its_own_voxel():
    rng = np.random.default_rng(1)
    points = rng.uniform(-3, 3, (5000, 3)).astype(np.float32)
    found = as_dict(voxel_filter(make_cloud(points), 0.5), 0.5)
    indices = np.floor(points.astype(float) / 0.5).astype(int)
    for key in [(0, 0, 0), (-6, -6, -6), (5, 5, 5), (-1, 0, 3)]:
        inside = (indices == key).all(axis=1)
        np.testing.assert_allclose(found[key][0], points[inside].astype(float).mean(axis=0), atol=1e-6)
        assert found[key][1] == inside.sum()
    assert sum(count for _, count in found.values()) == 5000


def test_points_are_taken_through_the_pose_first():
    X = np.eye(4)
    X[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    X[:3, 3] = [10, 20, 30]
    cloud = VoxelCloud(0.1).insert(make_cloud([[1, 2, 3]]), X).to_cloud()
    np.testing.assert_allclose(cloud.point.positions.numpy(), [[8, 21, 33]])


def test_an_attribute_that_only_some_points_have_is_their_mean_or_nan():
    cloud = VoxelCloud(1.0)
    cloud = cloud.insert(make_cloud([[0.5, 0.5, 0.5], [2.5, 0.5, 0.5]]))
    cloud = cloud.insert(make_cloud([[0.5] * 3, [0.5] * 3, [4.5] * 3], nir=np.float32([4, np.nan, np.nan])))
    cloud = cloud.insert(make_cloud([[0.5] * 3], nir=np.float32([8]), heat=np.float32([1])))
    result = cloud.to_cloud()
    by_x = dict(
        zip(result.point.positions.numpy()[:, 0].tolist(), result.point["nir"].numpy()[:, 0].tolist(), strict=True)
    )
    assert by_x[0.5] == 6
    assert np.isnan(by_x[2.5])
    assert np.isnan(by_x[4.5])
    heat = result.point["heat"].numpy()[:, 0]
    assert np.nansum(heat) == 1
    assert np.isnan(heat).sum() == 2


def test_attributes_of_the_ray_are_left_out():
    cloud = make_cloud([[0, 0, 0]], time=[0.1], ring=np.uint8([3]), column=np.uint16([9]), intensity=np.float32([1]))
    names = {name for name, _ in voxel_filter(cloud, 1.0).point.items()}
    assert names == {"positions", "count", "intensity"}


def test_means_inserted_again_keep_their_weight():
    points = np.array([[0.1] * 3, [0.2] * 3, [0.3] * 3])
    values = np.float32([0, 0, 3])
    once = voxel_filter(make_cloud(points, intensity=values), 1.0)
    both = VoxelCloud(1.0).insert(once).insert(make_cloud([[0.6] * 3], intensity=np.float32([5]))).to_cloud()
    np.testing.assert_allclose(both.point.positions.numpy(), [[0.3] * 3], atol=1e-7)
    np.testing.assert_allclose(both.point["intensity"].numpy(), [[2]])
    np.testing.assert_array_equal(both.point["count"].numpy(), [[4]])


def test_insertion_leaves_the_cloud_before_it_as_it_was():
    first = VoxelCloud(1.0).insert(make_cloud([[0.5] * 3]))
    copied = copy.deepcopy(first)
    first.insert(make_cloud([[0.7] * 3]))
    for cloud in (first, copied):
        np.testing.assert_array_equal(cloud.to_cloud().point["count"].numpy(), [[1]])
    assert len(VoxelCloud(1.0).to_cloud().point.positions) == 0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30])
def test_points_that_no_voxel_can_hold_are_left_out(bad):
    cloud = voxel_filter(make_cloud([[1, 2, 3], [bad, 0, 0], [0, 0, bad]]), 0.1)
    np.testing.assert_allclose(cloud.point.positions.numpy(), [[1, 2, 3]])


def test_insertions_move_each_voxel_only_a_few_times(monkeypatch):
    """With n clouds of one size, rewriting the whole at each insertion would move n²/2 clouds; runs move n log n."""
    moved = []
    original = np.argsort
    monkeypatch.setattr(np, "argsort", lambda keys, **options: moved.append(len(keys)) or original(keys, **options))
    cloud, rng = VoxelCloud(0.1), np.random.default_rng(0)
    for i in range(128):
        cloud = cloud.insert(make_cloud(rng.uniform(10 * i, 10 * i + 4, (200, 3))))
    assert sum(moved) < 200 * 128 * (2 + np.log2(128))
    assert np.median(moved) <= 800
