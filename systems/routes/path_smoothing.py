"""From a way over cells to a curve that a tracked robot drives without stopping, and that keeps its distance."""

from itertools import pairwise

import numpy as np

from ..config import check_config
from .ground import Ground
from .islands import Islands
from .route_config import SmoothingConfig
from .route_grid import RouteGrid
from .smoothing_kernels import relax, sample, segment, shortcut

# [cells] A straight cut keeps this distance from the centres of cells that cannot be entered.
_LEAST_ROOM = 0.75
# Rounds with tension.
_TENSE = 3


def smooth_path(
    xy: np.ndarray,
    grid: RouteGrid,
    ground: Ground,
    islands: Islands,
    config: SmoothingConfig | None = None,
    *,
    steep: float = 0.35,
) -> np.ndarray:
    """Smooths a way over cells: straight cuts where they cost no more, then bending taken out round by round.

    The result has the signature of `xy`, its ends, and points in free cells only. On ground steeper than `steep` the
    way stays as it is: a stair is climbed straight. Where obstacles leave no room for the curve a corner remains.

    Args:
        xy: (K, 2) in M [m], neighbouring points in neighbouring cells. steep: [rad].

    Returns:
        (L, 2) [m], points about `spacing` apart.

    Raises:
        ConfigError: a value of `config` is out of range.
    """
    config = config or SmoothingConfig()
    check_config(config, key="smoothing")
    if len(xy) < 3:
        return _resampled(xy, config.spacing)
    room = grid.clearance.astype(np.float64) / grid.cell
    points = (np.asarray(xy, float) - grid.origin) / grid.cell - 0.5
    steepness = np.hypot(ground.slope[..., 0], ground.slope[..., 1])
    gentle = steepness <= np.tan(steep)
    straight = gentle[tuple(np.rint(points).astype(int).T)]
    cost = _cost(points, ground.weight, room)
    kept = shortcut(points, cost, straight, ground.weight, room, _LEAST_ROOM, islands.table, config.tolerance)
    step = config.spacing / grid.cell
    curve = _resampled(points[kept], step)
    best = curve
    wanted, signature = config.max_curvature * grid.cell, islands.signature(grid, xy)
    for turn in range(config.rounds):
        fixed = np.array([sample(steepness, x, y) for x, y in curve]) > np.tan(steep)
        # Tension shortens the way at first; then it would pull it tight round corners.
        relax(curve, fixed, room, config.clearance / grid.cell, 0.1 if turn < _TENSE else 0.0, 40)
        curve = _resampled(curve, step)
        if not _is_open(curve, room) or islands.signature(grid, to_map(curve, grid)) != signature:
            break
        best = curve
        if _sharpest(curve) <= wanted:
            break
    return to_map(best, grid)


def to_map(points: np.ndarray, grid: RouteGrid) -> np.ndarray:
    """Points (K, 2) [cells, centres are whole] in M [m]."""
    return grid.origin + (points + 0.5) * grid.cell


def clearance_along(xy: np.ndarray, grid: RouteGrid) -> np.ndarray:
    """Clearance at points (K, 2) in M [m], between centres of cells in proportion, (K,) [m]."""
    points, room = (np.asarray(xy, float) - grid.origin) / grid.cell - 0.5, grid.clearance.astype(np.float64)
    return np.array([sample(room, x, y) for x, y in points])


def _cost(points: np.ndarray, weight: np.ndarray, room: np.ndarray) -> np.ndarray:
    parts = [segment(a[0], a[1], b[0], b[1], weight, room)[0] for a, b in pairwise(points)]
    return np.append(0.0, np.cumsum(parts))


def _resampled(points: np.ndarray, step: float) -> np.ndarray:
    """The polyline in points `step` apart, a little less so that they fit; the ends stay."""
    s = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    at = np.linspace(0, s[-1], max(int(np.ceil(s[-1] / step)), 1) + 1)
    return np.column_stack([np.interp(at, s, points[:, axis]) for axis in range(2)])


def _is_open(points: np.ndarray, room: np.ndarray) -> bool:
    cells = np.rint(points).astype(int)
    return bool((room[tuple(cells.T)] > 0).all())


def _sharpest(points: np.ndarray) -> float:
    """Largest curvature [1/cell]."""
    sides = np.diff(points, axis=0)
    turn = np.diff(np.unwrap(np.arctan2(sides[:, 1], sides[:, 0])))
    lengths = np.linalg.norm(sides, axis=1)
    return float(np.abs(turn / (0.5 * (lengths[:-1] + lengths[1:]))).max(initial=0.0))
