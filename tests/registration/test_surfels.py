"""Surfels: planes where there are planes, on range images and on any cloud, and none where there are none."""

import numpy as np
import open3d as o3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from naraha.systems.registration.config import SurfacesConfig
from naraha.systems.registration.grid_kernels import cell_means, sort_into_cells
from naraha.systems.registration.surfel_kernels import smallest_axis
from naraha.systems.registration.surfels import surfels_of
from naraha.systems.sensing import ScanPattern
from open3d.t.geometry import PointCloud

from tests.registration.scans import CORRIDOR, scan
from tests.rooms import make_cloud, pose

X_WS = pose(0.4, 0.2, 1.1, 0.02, -0.03, 0.7)


def box_room(half):
    return [([0, 0, 0], [2 * half[0], 2 * half[1], 2 * half[2]], 0.0)]


def distance_to_walls(points, normals, half):
    """Distance to the nearest face of a box around the origin, and angle to its normal [rad]."""
    apart = np.abs(np.abs(points) - half)
    face = apart.argmin(axis=1)
    rows = np.arange(len(points))
    return apart[rows, face], np.arccos(np.minimum(np.abs(normals[rows, face]), 1.0))


@pytest.mark.parametrize("organised", [True, False])
def test_surfels_of_a_room_lie_on_its_walls_and_stand_across_them(organised):
    half = np.array([5.0, 4.0, 1.5])
    X = pose(0.5, -0.3, -0.4, 0.02, 0.03, 0.6)
    cloud = scan(box_room(half), X, np.random.default_rng(0), noise=0.02, organised=organised)
    surfels = surfels_of(cloud, SurfacesConfig(spacing=0.15))
    assert len(surfels) > 1000
    points = X.multiply(surfels.data[:, :3].T).T
    normals = surfels.data[:, 3:6] @ X.rotation().matrix().T
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-9)
    distance, angle = distance_to_walls(points, normals, half)
    assert np.median(distance) < 0.005  # a quarter of the noise
    assert np.median(angle) < np.deg2rad(1.0)
    assert np.quantile(angle, 0.95) < np.deg2rad(4.0)
    if organised:
        assert ((surfels.data[:, :3] * surfels.data[:, 3:6]).sum(axis=1) < 0).all()  # towards the sensor
    assert surfels.signed == organised


def test_a_tilt_is_as_large_as_the_normals_scatter():
    half = np.array([5.0, 4.0, 1.5])
    X = pose(0.5, -0.3, -0.4, yaw=0.6)
    cloud = scan(box_room(half), X, np.random.default_rng(0), noise=0.02)
    data = surfels_of(cloud, SurfacesConfig(spacing=0.15)).data
    _, angle = distance_to_walls(X.multiply(data[:, :3].T).T, data[:, 3:6] @ X.rotation().matrix().T, half)
    inner = angle < np.quantile(angle, 0.9)  # near edges, two walls make one plane
    assert 0.3 < np.sqrt(np.mean(angle[inner] ** 2) / np.mean(data[inner, 6])) < 2


@pytest.mark.parametrize("organised", [True, False])
def test_no_surfel_of_a_corridor_stands_across_it(organised):
    """One ring makes a plane, that of the beams' cone, where it turns from the floor to the wall."""
    cloud = scan(CORRIDOR, pose(0, 0.2, 1.0, yaw=0.05), np.random.default_rng(1), max_range=12, organised=organised)
    surfels = surfels_of(cloud, SurfacesConfig(spacing=0.15))
    along = np.abs(surfels.data[:, 3:6] @ [np.cos(0.05), -np.sin(0.05), 0.0])
    assert len(surfels) > 500
    assert (along > 0.3).mean() < 0.002
    assert np.mean(along**2) < 0.001


def test_missing_returns_and_the_order_of_points_change_little_or_nothing():
    rng = np.random.default_rng(2)
    cloud = scan(box_room([5, 4, 1.5]), pose(0, 0, 0), rng)
    config = SurfacesConfig(spacing=0.15)
    shuffled = rng.permutation(len(cloud.point.positions))
    same = cloud.select_by_index(o3d.core.Tensor(shuffled))
    np.testing.assert_array_equal(surfels_of(same, config).data, surfels_of(cloud, config).data)
    most = surfels_of(cloud.select_by_mask(o3d.core.Tensor(rng.random(len(shuffled)) < 0.8)), config)
    assert len(most) > 0.8 * len(surfels_of(cloud, config))


def test_one_ring_alone_makes_no_surfels():
    pattern = ScanPattern(
        elevations=np.zeros(1), azimuths=np.linspace(-2, 2, 1000), times=np.linspace(0, 0.09, 1000), period=0.1,
        min_range=0.1, max_range=30.0, range_noise=0.01, detection_range=30.0,
    )  # fmt: skip
    cloud = scan(box_room([5, 4, 1.5]), pose(0, 0, 0), np.random.default_rng(3), pattern=pattern)
    assert len(surfels_of(cloud, SurfacesConfig(spacing=0.15))) == 0


def test_a_dense_image_is_reduced_and_gives_the_same_walls():
    """64 rings and 2048 columns: about as many surfels as 16 rings give, with less noise."""
    pattern = ScanPattern(
        elevations=np.deg2rad(np.linspace(-20, 20, 64)), azimuths=np.linspace(np.pi, -np.pi, 2048, endpoint=False),
        times=np.linspace(0, 0.09, 2048), period=0.1, min_range=0.1, max_range=30.0, range_noise=0.01,
        detection_range=30.0,
    )  # fmt: skip
    half = np.array([5.0, 4.0, 1.5])
    cloud = scan(box_room(half), pose(0, 0, 0), np.random.default_rng(4), noise=0.02, pattern=pattern)
    surfels = surfels_of(cloud, SurfacesConfig(spacing=0.15))
    distance, angle = distance_to_walls(surfels.data[:, :3], surfels.data[:, 3:6], half)
    assert 1000 < len(surfels) < 10000
    assert np.median(distance) < 0.003
    assert np.median(angle) < np.deg2rad(0.6)


def test_clouds_without_surfaces_have_no_surfels_but_clutter():
    rng = np.random.default_rng(5)
    for points in (np.zeros((0, 3)), np.full((50, 3), np.nan), np.tile([[1.0, 2.0, 3.0]], (500, 1))):
        assert len(surfels_of(make_cloud(points), SurfacesConfig(spacing=0.15))) == 0
    assert len(surfels_of(PointCloud(), SurfacesConfig(spacing=0.15))) == 0
    leaves = surfels_of(make_cloud(rng.uniform(-1, 1, (3000, 3))), SurfacesConfig(spacing=0.15))
    assert len(leaves.clutter) > 10 * len(leaves)


def test_probabilities_of_classes_are_those_of_the_surfels_own_points():
    rng = np.random.default_rng(6)
    cloud = scan(box_room([5, 4, 1.5]), pose(0, 0, 0), rng)
    for organised in (True, False):
        if not organised:
            cloud = make_cloud(cloud.point.positions.numpy())
        left = cloud.point.positions.numpy()[:, 1] > 0
        cloud.point["class_probabilities"] = o3d.core.Tensor(np.eye(2, dtype=np.float32)[left.astype(int)])
        surfels = surfels_of(cloud, SurfacesConfig(spacing=0.15))
        assert surfels.probabilities.shape == (len(surfels), 2)
        assert np.mean((surfels.data[:, 1] > 0) == surfels.probabilities.argmax(axis=1)) > 0.98
        assert surfels_of(cloud, SurfacesConfig(spacing=0.15, classes=False)).probabilities.shape == (len(surfels), 0)


@given(seed=st.integers(0, 10000), scale=st.sampled_from([1e-3, 1.0, 1e3]))
def test_the_smallest_axis_is_that_of_numpy(seed, scale):
    rng = np.random.default_rng(seed)
    root = rng.normal(0, scale, (3, 3)) * rng.uniform(0.01, 1, 3)
    C = root @ root.T
    small, middle, large, *axis = smallest_axis(C[np.triu_indices(3)])
    values, vectors = np.linalg.eigh(C)
    np.testing.assert_allclose([small, middle, large], values, atol=1e-9 * values[2])
    if values[0] < 0.9 * values[1]:
        assert abs(np.dot(axis, vectors[:, 0])) > 1 - 1e-6


@settings(max_examples=30)
@given(seed=st.integers(0, 10000), count=st.integers(0, 300), cell=st.floats(0.05, 3.0))
def test_points_are_in_their_own_cells(seed, count, cell):
    points = np.random.default_rng(seed).normal(0, 2, (count, 3))
    keys, ends, order, cells = sort_into_cells(points, cell)
    assert sorted(order) == list(range(count))
    where = np.floor(points / cell)
    occupied = np.flatnonzero(keys >= 0)
    assert len(occupied) == cells == len(np.unique(where, axis=0))
    for slot in occupied:
        assert len(np.unique(where[order[ends[slot, 0] : ends[slot, 1]]], axis=0)) == 1
    means, counts, first = cell_means(points, np.ones(count), cell)
    assert counts.sum() == count
    for mean, number, index in zip(means, counts, first, strict=True):
        members = (where == where[index]).all(axis=1)
        assert members.sum() == number
        np.testing.assert_allclose(mean, points[members].mean(axis=0), atol=1e-9)
