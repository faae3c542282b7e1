"""Regions: areas of known shapes, outlines that are simple polygons, groups in plan and in space."""

import copy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from naraha.systems.hazards.regions import RegionConfig, find_regions, group_points, trace_outline


def disc_scene(rng, radius, centre, count=40_000, half=1.5):
    """Points all over a square and whether they are on the disc."""
    points = np.column_stack([rng.uniform(-half, half, (count, 2)) + centre, np.zeros(count)])
    return points, np.hypot(*(points[:, :2] - centre).T) < radius


def one_per_cell(points, cell):
    return points[np.unique(np.floor(points / cell).astype(int), axis=0, return_index=True)[1]]


def polygon_area(outline):
    x, y = outline.T
    return 0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)


def crossings(outline):
    """How many pairs of sides cross. Corners lie halfway between whole numbers: sides cannot touch otherwise."""
    a, b = outline[:, None], np.roll(outline, -1, axis=0)[:, None]

    def side(p, q, r):
        return (q - p)[..., 0] * (r - p)[..., 1] - (q - p)[..., 1] * (r - p)[..., 0]

    c, d = a.swapaxes(0, 1), b.swapaxes(0, 1)
    return np.sum((side(a, b, c) * side(a, b, d) < 0) & (side(c, d, a) * side(c, d, b) < 0))


@pytest.mark.parametrize("radius", [0.25, 0.4, 0.8])
def test_the_area_of_a_disc_has_no_bias(radius):
    areas = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        points, inside = disc_scene(rng, radius, rng.uniform(-1, 1, 2))
        ((region, members),) = find_regions(points, inside.astype(float), RegionConfig(), name="water")
        assert len(members) == region.points == inside.sum()
        areas.append(region.area)
    assert np.mean(areas) == pytest.approx(np.pi * radius**2, rel=0.02)
    np.testing.assert_allclose(areas, np.pi * radius**2, rtol=0.06)


def test_the_area_of_a_disc_has_no_bias_in_a_map_of_one_point_a_voxel():
    areas = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        centre = rng.uniform(-1, 1, 2)
        points = one_per_cell(disc_scene(rng, 0.4, centre)[0], 0.1)
        inside = np.hypot(*(points[:, :2] - centre).T) < 0.4
        areas.append(find_regions(points, inside.astype(float), RegionConfig(), name="water")[0][0].area)
    assert np.mean(areas) == pytest.approx(np.pi * 0.16, rel=0.03)


def test_a_region_says_where_it_is_and_how_sure():
    rng = np.random.default_rng(2)
    points, inside = disc_scene(rng, 0.5, np.array([4.0, -7.0]))
    points[:, 2] = rng.uniform(0.1, 0.2, len(points))
    ((region, _),) = find_regions(points, np.where(inside, 0.9, 0.2), RegionConfig(), name="water")
    np.testing.assert_allclose(region.p_MC, [4, -7, 0.15], atol=0.02)
    assert region.probability == pytest.approx(0.9)
    assert region.label == "water"
    np.testing.assert_allclose(region.low_M, [3.5, -7.5, 0.1], atol=0.02)
    np.testing.assert_allclose(region.high_M, [4.5, -6.5, 0.2], atol=0.02)
    assert polygon_area(region.outline_M) == pytest.approx(np.pi / 4, rel=0.08)
    distance = np.hypot(*(region.outline_M - [4, -7]).T)
    assert distance.min() > 0.4
    assert distance.max() < 0.6
    assert copy.deepcopy(region) is region


def test_the_outline_follows_a_bay():
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(0, 2, (60_000, 2)), np.zeros(60_000)])
    bay = (np.abs(points[:, 0] - 1) < 0.4) & (points[:, 1] > 0.5)
    ((region, _),) = find_regions(points, (~bay).astype(float), RegionConfig(), name="water")
    assert region.area == pytest.approx(4 - 0.8 * 1.5, rel=0.03)
    assert polygon_area(region.outline_M) == pytest.approx(4 - 0.8 * 1.5, rel=0.03)


@settings(max_examples=60, deadline=None)
@given(bits=st.lists(st.booleans(), min_size=1, max_size=36), width=st.integers(1, 6))
def test_every_outline_is_one_simple_polygon_around_all_cells(bits, width):
    bits = [*bits, *[False] * (-len(bits) % width)]
    mask = np.array(bits).reshape(-1, width)
    mask[0, 0] = True
    outline = trace_outline(mask)
    assert polygon_area(outline) >= mask.sum() - 0.5 - 1e-9
    assert crossings(outline) == 0
    assert len(np.unique(outline, axis=0)) == len(outline)
    cells = np.argwhere(mask) + 0.5
    assert (outline.min(axis=0) < cells.min(axis=0)).all()
    assert (outline.max(axis=0) > cells.max(axis=0)).all()


def test_cells_that_nothing_was_seen_in_belong_to_the_region_around_them():
    rng = np.random.default_rng(4)
    points, inside = disc_scene(rng, 0.8, np.zeros(2))
    unseen = np.hypot(*points[:, :2].T) < 0.3
    ((region, _),) = find_regions(points[~unseen], inside[~unseen].astype(float), RegionConfig(), name="water")
    assert region.area == pytest.approx(np.pi * 0.64, rel=0.04)
    dry = np.where(unseen, 0.0, inside)  # an island that was seen does not
    ((region, _),) = find_regions(points, dry, RegionConfig(), name="water")
    assert region.area == pytest.approx(np.pi * (0.64 - 0.09), rel=0.04)


def test_groups_in_plan_join_what_groups_in_space_keep_apart():
    low = np.column_stack([np.mgrid[0:0.5:0.05, 0:0.5:0.05].reshape(2, -1).T, np.zeros(100)])
    points = np.vstack([low, low + np.array([0, 0, 1.0])])
    sure = np.ones(len(points))
    assert len(find_regions(points, sure, RegionConfig(), name="heat")) == 1
    assert [r.points for r, _ in find_regions(points, sure, RegionConfig(), name="heat", in_space=True)] == [100, 100]


@pytest.mark.parametrize(("distance", "groups"), [(0.2, 1), (0.4, 2)])
def test_points_belong_together_up_to_the_reach(distance, groups):
    points = np.array([[0.05, 0.05], [0.05 + distance, 0.05]])
    assert len(set(group_points(points, 0.1, 0.25))) == groups


def test_small_regions_are_dropped_and_the_largest_comes_first():
    rng = np.random.default_rng(5)
    points = np.column_stack([rng.uniform(0, 6, (60_000, 2)), np.zeros(60_000)])
    probability = np.zeros(len(points))
    for x, radius in ((1, 0.3), (3, 0.6), (5, 0.08)):
        probability[np.hypot(points[:, 0] - x, points[:, 1] - 3) < radius] = 1
    found = [region.p_MC[0] for region, _ in find_regions(points, probability, RegionConfig(), name="water")]
    np.testing.assert_allclose(found, [3, 1], atol=0.05)


def test_nothing_comes_of_nothing():
    config = RegionConfig()
    assert find_regions(np.zeros((0, 3)), np.zeros(0), config, name="water") == []
    assert find_regions(np.zeros((1, 3)), np.ones(1), config, name="water") == []
    assert find_regions(np.full((9, 3), np.nan), np.ones(9), config, name="water") == []
    assert find_regions(np.random.default_rng(0).random((99, 3)), np.full(99, np.nan), config, name="water") == []
    single = find_regions(np.zeros((1, 3)), np.ones(1), RegionConfig(min_points=1, min_area=0), name="water")[0][0]
    assert single.area == pytest.approx(0.01)
    assert len(single.outline_M) == 4
