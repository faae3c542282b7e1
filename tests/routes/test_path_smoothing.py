import numpy as np
import pytest
from naraha.systems.errors import ConfigError
from naraha.systems.routes import OCCUPIED, RouteGrid, RoutesConfig, SmoothingConfig
from naraha.systems.routes.find_routes import find_ways
from naraha.systems.routes.ground import make_ground
from naraha.systems.routes.islands import find_islands
from naraha.systems.routes.path_smoothing import clearance_along, smooth_path
from naraha.systems.tracking import Path

from .maps import fenced, hall_map, water_map


def prepare(grid, start, goal):
    config = RoutesConfig()
    ground, islands = make_ground(grid, config), find_islands(grid)
    first, last = grid.free_index_of(np.asarray(start)[:2]), grid.free_index_of(np.asarray(goal))
    ways = find_ways(grid, ground, islands, first, last, config)
    return [grid.centre_of(way.cells) for way in ways], ground, islands


@pytest.mark.parametrize("make", [hall_map, water_map])
@pytest.mark.parametrize("seed", range(6))
def test_a_smooth_path_is_shorter_passes_islands_alike_and_keeps_its_ends(make, seed):
    grid, start, goal = make(seed)
    ways, ground, islands = prepare(grid, start, goal)
    for cells in ways[:3]:
        smooth = smooth_path(cells, grid, ground, islands)
        assert islands.signature(grid, smooth) == islands.signature(grid, cells)
        np.testing.assert_allclose(smooth[[0, -1]], cells[[0, -1]])
        assert Path(xy=smooth).length_m <= Path(xy=cells).length_m * 1.02
        assert clearance_along(smooth, grid).min() >= 0.7 * grid.cell


def test_in_the_open_the_curvature_limit_is_kept_and_the_clearance_too():
    kind = fenced(80, 60)
    kind[35:45, 0:35] = OCCUPIED
    grid = RouteGrid.from_kind(kind, 0.1)
    (cells,), ground, islands = prepare(grid, grid.centre_of([10, 10]), grid.centre_of([70, 10]))
    smooth = smooth_path(cells, grid, ground, islands, SmoothingConfig(max_curvature=1.5, clearance=0.3))
    assert np.abs(Path(xy=smooth).curvature).max() <= 1.5
    assert clearance_along(smooth, grid).min() > 0.25


def test_a_straight_way_stays_straight():
    grid = RouteGrid.from_kind(fenced(40, 20), 0.2)
    (cells,), ground, islands = prepare(grid, grid.centre_of([3, 10]), grid.centre_of([35, 13]))
    smooth = smooth_path(cells, grid, ground, islands)
    assert Path(xy=smooth).length_m == pytest.approx(np.hypot(*(cells[-1] - cells[0])), rel=1e-3)


def test_steps_are_even_and_about_the_spacing():
    grid, start, goal = hall_map(1)
    ways, ground, islands = prepare(grid, start, goal)
    smooth = smooth_path(ways[0], grid, ground, islands, SmoothingConfig(spacing=0.05))
    steps = np.linalg.norm(np.diff(smooth, axis=0), axis=1)
    assert steps.max() <= 0.0501
    assert steps.min() > 0.045


def test_bad_config_is_refused():
    grid, start, goal = hall_map(0)
    ways, ground, islands = prepare(grid, start, goal)
    with pytest.raises(ConfigError, match=r"smoothing\.spacing"):
        smooth_path(ways[0], grid, ground, islands, SmoothingConfig(spacing=0))
