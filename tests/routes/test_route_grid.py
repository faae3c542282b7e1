import copy

import numpy as np
import pytest
from naraha.systems.errors import InputError
from naraha.systems.routes import FENCE, FREE, OCCUPIED, WATER, RouteGrid, clearance_of

from .maps import connected, fenced, hall_map, maze_map, water_map


@pytest.fixture
def grid():
    kind = fenced(10, 6)
    kind[4, 2:4] = WATER
    return RouteGrid.from_kind(kind, 0.5, (-1.0, 2.0))


def test_a_point_and_its_cell_find_each_other(grid):
    ij = np.argwhere(grid.kind == FREE)
    assert np.array_equal(grid.index_of(grid.centre_of(ij)), ij)
    assert np.allclose(grid.centre_of([0, 0]), [-0.75, 2.25])
    assert np.array_equal(grid.index_of([-1.0, 2.0]), [0, 0])
    assert not grid.contains([4.0, 3.0])  # the far edge belongs to the next cell
    assert not grid.contains([np.nan, 3.0])


def test_a_point_outside_is_refused_and_the_nearest_free_cell_is_named(grid):
    with pytest.raises(InputError, match=r"outside the grid.*nearest free cell at \(3\.250, 2\.750\) m"):
        grid.free_index_of(np.array([9.0, 2.7]))


def test_a_point_in_water_is_refused_and_says_so(grid):
    with pytest.raises(InputError, match=r"goal: in a cell that is water.*nearest free cell at \(0\.750, 3\.250\) m"):
        grid.free_index_of(np.array([1.2, 3.2]), "goal")


def test_when_nothing_is_free_the_error_does_not_fail_itself():
    grid = RouteGrid.from_kind(np.full((3, 3), OCCUPIED), 1.0)
    with pytest.raises(InputError, match="no cell is free"):
        grid.free_index_of(np.array([0.5, 0.5]))


def test_clearance_is_the_distance_to_the_nearest_wall_and_the_edge_is_one():
    assert np.allclose(clearance_of(np.zeros((5, 5), np.uint8), 0.2)[:, 2], [0.2, 0.4, 0.6, 0.4, 0.2])
    kind = np.zeros((9, 9), np.uint8)
    kind[4, 4] = WATER
    assert clearance_of(kind, 1.0)[6, 6] == pytest.approx(np.hypot(2, 2))
    assert clearance_of(kind, 1.0)[4, 4] == 0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"kind": np.zeros(4)}, "plane of cells"),
        ({"kind": np.full((3, 3), 9)}, "unknown kind"),
        ({"cell": 0.0}, "cell must be positive"),
        ({"cost": np.full((3, 3), 0.5)}, "cost below 1"),
        ({"cost": np.full((3, 3), np.nan)}, "cost below 1"),
        ({"height": np.zeros((3, 4))}, "height does not fit"),
        ({"origin": (np.nan, 0.0)}, "origin must be"),
    ],
)
def test_what_is_no_grid_is_refused(change, words):
    with pytest.raises(InputError, match=words):
        RouteGrid.from_kind(**({"kind": np.zeros((3, 3)), "cell": 0.1} | change))


def test_the_arrays_are_copies_that_cannot_be_written(grid):
    kind = np.zeros((3, 3), np.uint8)
    made = RouteGrid.from_kind(kind, 0.1)
    kind[:] = WATER
    assert not made.blocked.any()
    with pytest.raises(ValueError, match="read-only"):
        made.kind[0, 0] = 1


def test_the_fingerprint_tells_grids_apart_by_cells_place_and_size(grid):
    same = RouteGrid.from_kind(grid.kind, grid.cell, grid.origin)
    other_kind = grid.kind.copy()
    other_kind[1, 1] = FENCE
    others = [
        RouteGrid.from_kind(other_kind, grid.cell, grid.origin),
        RouteGrid.from_kind(grid.kind, grid.cell, grid.origin + 0.1),
        RouteGrid.from_kind(grid.kind, 0.4, grid.origin),
        RouteGrid.from_kind(grid.kind.reshape(6, 10), grid.cell, grid.origin),
        RouteGrid.from_kind(grid.kind, grid.cell, grid.origin, cost=np.full(grid.shape, 2.0)),
    ]
    assert same.fingerprint == grid.fingerprint == copy.deepcopy(grid).fingerprint
    assert len({g.fingerprint for g in [grid, *others]}) == 6


@pytest.mark.parametrize("seed", range(10))
def test_the_maps_for_tests_are_what_they_say(seed):
    for make in (hall_map, maze_map):
        grid, start, goal = make(seed)
        assert connected(grid.kind, grid.free_index_of(start[:2]), grid.free_index_of(np.array(goal)))
    for sides, way in (("both", True), ("left", True), ("right", True), ("none", False)):
        grid, start, goal = water_map(seed, sides)
        ends = grid.free_index_of(start[:2]), grid.free_index_of(np.array(goal))
        assert connected(grid.kind, *ends) is way
        pool = grid.kind == WATER
        column = np.flatnonzero(pool.any(axis=1)).mean().round().astype(int)
        assert (grid.kind[column, -4:-1] == FREE).all() == (sides in ("both", "left"))
        assert (grid.kind[column, 1:4] == FREE).all() == (sides in ("both", "right"))
