"""Rays pass exactly the voxels that they cross."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from naraha.systems.voxel_map.carving import HIT, PASSED, VOXELS, carve, locate, pack_blocks, unpack_blocks

VOXEL = 0.1


def marked(scan, kind):
    """Indices of the voxels of one kind, as a set of triples."""
    row, place = np.nonzero(scan.marks == kind)
    inner = np.stack([place // 64, place // 8 % 8, place % 8], axis=-1)
    return set(map(tuple, (unpack_blocks(scan.keys)[row] * 8 + inner).tolist()))


def follow(start, end, max_range=1e4):
    """What a ray passes and hits, given in voxels."""
    scan = carve(np.array([end]) * VOXEL, np.array(start) * VOXEL, VOXEL, max_range)
    return marked(scan, PASSED), marked(scan, HIT)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_ray_along_an_axis_passes_a_row_across_blocks(axis, sign):
    end = [0.5, 0.5, 0.5]
    end[axis] += 20 * sign
    row = np.zeros((20, 3), int)
    row[:, axis] = sign * np.arange(20)
    passed, hit = follow([0.5, 0.5, 0.5], end)
    assert passed == set(map(tuple, row.tolist()))
    assert hit == {tuple(np.floor(end).astype(int).tolist())}


def test_a_ray_through_corners_steps_along_z_then_y_then_x():
    passed, hit = follow([0.5, 0.5, 0.5], [2.5, 2.5, 2.5])
    assert passed == {(0, 0, 0), (0, 0, 1), (0, 1, 1), (1, 1, 1), (1, 1, 2), (1, 2, 2)}
    assert hit == {(2, 2, 2)}


def test_a_ray_through_edges_passes_one_of_the_voxels_beside_each():
    passed, _ = follow([0.5, 0.5, 0.5], [-2.5, 3.5, 0.5])
    assert passed == {(0, 0, 0), (0, 1, 0), (-1, 1, 0), (-1, 2, 0), (-2, 2, 0), (-2, 3, 0)}


def test_a_ray_of_no_length_only_hits():
    assert follow([3.2, 3.2, 3.2], [3.2, 3.2, 3.2]) == (set(), {(3, 3, 3)})
    assert follow([3.2, 3.2, 3.2], [3.7, 3.9, 3.1]) == (set(), {(3, 3, 3)})


def test_beyond_the_range_a_ray_passes_but_does_not_hit():
    passed, hit = follow([0.5, 0.5, 0.5], [50.5, 0.5, 0.5], max_range=1.02)
    assert passed == {(x, 0, 0) for x in range(10)}
    assert hit == set()


def test_a_hit_wins_over_rays_that_pass():
    points = np.array([[5.5, 0.5, 0.5], [9.5, 0.5, 0.5]]) * VOXEL
    for order in (points, points[::-1]):
        scan = carve(order, np.full(3, 0.5 * VOXEL), VOXEL, 100.0)
        assert marked(scan, HIT) == {(5, 0, 0), (9, 0, 0)}
        assert marked(scan, PASSED) == {(x, 0, 0) for x in (0, 1, 2, 3, 4, 6, 7, 8)}


def test_points_that_are_not_finite_or_too_far_are_left_out():
    bad = [[np.nan, 0, 0], [np.inf, 0, 0], [0, -np.inf, 0], [0, 0, 1e9]]
    scan = carve(np.array([*bad, [0.55, 0.05, 0.05]]), np.full(3, 0.05), VOXEL, np.inf)
    assert scan.target[:4].tolist() == [-1] * 4
    assert len(marked(scan, PASSED)) == 5
    assert marked(scan, HIT) == {(5, 0, 0)}
    only_bad = carve(np.array(bad), np.zeros(3), VOXEL, np.inf)
    assert len(only_bad.keys) == 0


def test_points_without_a_ray_hit_and_do_not_carve():
    points = np.array([[0.95, 0.05, 0.05], [0.05, 0.95, 0.05]])
    scan = carve(points, np.full(3, 0.05), VOXEL, 100.0, rays=np.array([True, False]))
    assert marked(scan, PASSED) == {(x, 0, 0) for x in range(9)}
    assert marked(scan, HIT) == {(9, 0, 0), (0, 9, 0)}


def test_targets_say_which_voxel_each_point_hit():
    points = np.random.default_rng(0).uniform(-3, 3, (200, 3))
    scan = carve(points, np.zeros(3), VOXEL, 100.0)
    keys, places = locate(points, VOXEL)
    np.testing.assert_array_equal(scan.keys[scan.target // VOXELS], keys)
    np.testing.assert_array_equal(scan.target % VOXELS, places)


def test_more_blocks_than_expected_change_nothing():
    points = np.random.default_rng(1).uniform(-20, 20, (300, 3))
    few, many = (carve(points, np.zeros(3), VOXEL, 100.0, expected_blocks=count) for count in (1, 30_000))
    for name in ("keys", "marks", "target"):
        np.testing.assert_array_equal(getattr(few, name), getattr(many, name))


@pytest.mark.parametrize("origin", [[np.nan, 0, 0], [1e9, 0, 0], [0, 0]])
def test_an_unusable_origin_is_refused(origin):
    with pytest.raises(ValueError, match="origin"):
        carve(np.zeros((1, 3)), np.array(origin, float), VOXEL, 100.0)


def test_wrong_shapes_are_refused():
    with pytest.raises(ValueError, match="points"):
        carve(np.zeros((3, 2)), np.zeros(3), VOXEL, 100.0)
    with pytest.raises(ValueError, match="rays"):
        carve(np.zeros((3, 3)), np.zeros(3), VOXEL, 100.0, rays=np.ones(2, bool))


def crossed(start, end):
    """Voxels that a segment (in voxels) crosses, by the slab method on all in reach, and those it may only touch."""
    low, high = np.floor(np.minimum(start, end)).astype(int), np.floor(np.maximum(start, end)).astype(int)
    cells = low + np.argwhere(np.ones(high - low + 1, bool))
    along = end - start
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        borders = np.stack([(cells - start) / along, (cells + 1 - start) / along])
    near = np.where(along == 0, -np.inf, borders.min(axis=0)).max(axis=1)
    far = np.where(along == 0, np.inf, borders.max(axis=0)).min(axis=1)
    share = np.minimum(far, 1.0) - np.maximum(near, 0.0)
    return tuple(set(map(tuple, cells[chosen].tolist())) for chosen in (share > 1e-9, np.abs(share) <= 1e-9))


coordinate = st.floats(-9, 9, allow_nan=False)


@settings(max_examples=100)
@given(st.tuples(coordinate, coordinate, coordinate), st.tuples(coordinate, coordinate, coordinate))
def test_every_ray_passes_what_the_slab_method_says(start, end):
    start, end = np.array(start), np.array(end)
    scan = carve(end[None], start, 1.0, 100.0)
    expected, doubtful = crossed(start, end)
    hit, passed = marked(scan, HIT), marked(scan, PASSED)
    assert hit == {tuple(np.floor(end).astype(int).tolist())}
    assert expected - hit - passed == set()
    assert passed - expected - doubtful == set()


@given(st.lists(st.tuples(*[st.integers(-(1 << 20), (1 << 20) - 1)] * 3), min_size=1))
def test_keys_of_blocks_come_back(blocks):
    np.testing.assert_array_equal(unpack_blocks(pack_blocks(np.array(blocks))), blocks)
