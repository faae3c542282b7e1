"""Several really different ways to one goal: past the islands of the grid on different sides (S0-h, S0-i)."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from ..config import check_config
from ..errors import InputError
from .ground import Ground, make_ground
from .islands import Islands, find_islands
from .motion_model import MotionModel
from .path_smoothing import smooth_path
from .route import Route
from .route_config import RoutesConfig
from .route_grid import RouteGrid
from .route_measures import measure_route
from .search_kernels import best_of_each_class, tree

# [rad] A way that is seen from an island in a wider range of directions goes round it, not past it.
_ROUND = 1.5 * np.pi


@dataclass(frozen=True, eq=False)
class Way:
    """A way over cells.

    Attributes:
        cells: (K, 2) int64. cost: [cells]. signature: see `Islands`.
    """

    cells: np.ndarray
    cost: float
    signature: tuple[int, ...]


def find_routes(
    grid: RouteGrid,
    start: np.ndarray,
    goal: np.ndarray,
    config: RoutesConfig | None = None,
    *,
    motion: MotionModel | None = None,
) -> tuple[Route, ...]:
    """Routes from `start` to `goal` of which no two pass all islands on the same sides, the best first.

    Ways that meet themselves or go round an island are left out. The best way of each class is found by a search over
    cells × signatures (`best_of_each_class`), and the best way by way of each cell, which finds the other side of a
    large island also where many small ones make many classes.
    Of these the cheapest is taken, then again and again the cheapest of the rest, where running along the taken ones
    counts as costlier; one that is nowhere `separation` away from a taken one is left out.

    Args:
        start: (3,) x, y, heading or (2,) x, y in M [m, m, rad]. goal: (2,) [m].
        motion: outcomes of motions, for the confidence.

    Returns:
        Routes, none when no way leads there. A start in the goal's own cell has none either.

    Raises:
        ConfigError: a value of `config` is out of range.
        InputError: start or goal is outside the grid or not free; the error names the nearest free cell.
    """
    config = config or RoutesConfig()
    check_config(config, key="routes")
    start, goal = np.asarray(start, float), np.asarray(goal, float)
    if start.shape not in ((2,), (3,)) or not np.isfinite(start).all():
        raise InputError("not a pose", where="start", value=start.tolist(), valid="x, y, heading, finite")
    if goal.shape != (2,) or not np.isfinite(goal).all():
        raise InputError("not a place", where="goal", value=goal.tolist(), valid="x, y, finite")
    first, last = grid.free_index_of(start[:2], "start"), grid.free_index_of(goal, "goal")
    ground, islands = make_ground(grid, config), find_islands(grid)
    ways = _different(find_ways(grid, ground, islands, first, last, config), grid, config)
    routes = []
    for way in ways:
        centres = grid.centre_of(way.cells)
        xy = smooth_path(centres, grid, ground, islands, config.smoothing, steep=config.max_roll)
        heading = float(start[2]) if len(start) == 3 else None
        routes.append(measure_route(xy, grid, ground, islands, config, heading=heading, motion=motion))
    return tuple(routes)


def find_ways(
    grid: RouteGrid, ground: Ground, islands: Islands, first: np.ndarray, last: np.ndarray, config: RoutesConfig
) -> list[Way]:
    """The best way of every class that was found, the cheapest first; empty when there is none.

    Args:
        first, last: (2,) cells.
    """
    ny = grid.shape[1]
    start, goal = int(first[0] * ny + first[1]), int(last[0] * ny + last[1])
    to_go, next_cell, crossed_to = tree(goal, ground.weight, ground.moves, islands.table, True)
    if start == goal or not np.isfinite(to_go[start]):
        return []
    limit = config.max_stretch * to_go[start]
    found, cells, parents = best_of_each_class(
        start, goal, ground.weight, ground.moves, islands.table, to_go, config.classes, limit, config.states
    )
    chains = [_chain(int(state), parents)[::-1] for state in found]
    candidates = [cells[chain] for chain in chains]
    so_far, before, crossed_from = tree(start, ground.weight, ground.moves, islands.table, False)
    through, total = crossed_from + crossed_to, so_far + to_go
    order = np.argsort(total, kind="stable")
    order = order[total[order] <= limit]
    _, which = np.unique(through[order], return_index=True)
    for cell in order[np.sort(which)]:
        there = np.array(_chain(int(cell), before)[::-1])
        candidates.append(np.append(there, _chain(int(cell), next_cell)[1:]).astype(np.int64))
    best: dict[tuple[int, ...], Way] = {}
    for candidate in candidates:
        if len(np.unique(candidate)) < len(candidate):
            continue
        places = np.column_stack([candidate // ny, candidate % ny])
        centres = grid.centre_of(places)
        if len(islands) and (np.ptp(islands.bearings(grid, centres), axis=1) > _ROUND).any():
            continue
        way = Way(places, _cost(places, ground.weight), islands.signature(grid, centres))
        if way.signature not in best or way.cost < best[way.signature].cost:
            best[way.signature] = way
    return sorted(best.values(), key=lambda way: way.cost)


def is_open(route: Route, grid: RouteGrid) -> bool:
    """Whether a route can still be driven on another grid, such as that of a newer map."""
    return blocked_at(route, grid) is None


def blocked_at(route: Route, grid: RouteGrid) -> float | None:
    """How far along a route the first point is that lies outside the grid or is not free [m]; None when none does."""
    if not len(route.xy):
        return None
    s = np.linspace(0, route.length_m, max(int(np.ceil(2 * route.length_m / grid.cell)), 1) + 1)
    xy = np.column_stack([np.interp(s, route.arc_length, route.xy[:, axis]) for axis in range(2)])
    closed = ~grid.contains(xy)
    inside = grid.index_of(xy[~closed])
    closed[~closed] = grid.blocked[tuple(inside.T)]
    return float(s[np.argmax(closed)]) if closed.any() else None


def _different(ways: list[Way], grid: RouteGrid, config: RoutesConfig) -> list[Way]:
    """The ways that are offered."""
    left = [(way, way.cells * grid.cell, np.zeros(len(way.cells), bool)) for way in ways]
    chosen: list[Way] = []
    while left and len(chosen) < config.most:
        scores = [way.cost * (1 + config.overlap_penalty * near.mean()) for way, _, near in left]
        way, points, _ = left.pop(int(np.argmin(scores)))
        chosen.append(way)
        tree_of_way, remaining = KDTree(points), []
        for other, xy, near in left:
            away = tree_of_way.query(xy)[0]
            apart = max(away.max(), KDTree(xy).query(points)[0].max())
            if apart >= config.separation:
                remaining.append((other, xy, near | (away < config.separation)))
        left = remaining
    return sorted(chosen, key=lambda way: way.cost)


def _chain(at: int, towards: np.ndarray) -> list[int]:
    chain = []
    while at >= 0:
        chain.append(at)
        at = int(towards[at])
    return chain


def _cost(cells: np.ndarray, weight: np.ndarray) -> float:
    w, lengths = weight[tuple(cells.T)], np.linalg.norm(np.diff(cells, axis=0), axis=1)
    return float((0.5 * (w[:-1] + w[1:]) * lengths).sum())
