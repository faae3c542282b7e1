"""What an operator wants to know of a route: how long, how near, how steep, how much dose, how sure."""

import numpy as np

from ..tracking import Path
from .ground import Ground
from .islands import Islands
from .motion_model import FORWARD, MotionModel
from .path_smoothing import clearance_along
from .route import Route
from .route_config import RoutesConfig
from .route_grid import FENCE, KINDS, UNKNOWN, RouteGrid
from .smoothing_kernels import sample

# [cells] Where there is less room a motion that goes wrong touches something.
_NARROW = 1.5


def measure_route(
    xy: np.ndarray,
    grid: RouteGrid,
    ground: Ground,
    islands: Islands,
    config: RoutesConfig,
    *,
    heading: float | None = None,
    motion: MotionModel | None = None,
) -> Route:
    """The route along points (K, 2) in M [m], all in free cells.

    The time is that of turning from `heading` [rad] to the route at the start, and of driving at `speed`, less in
    curves (`turn_rate`) and on slopes (`slope_slowdown`). The confidence is the share of cells within `look` that are
    neither unknown nor fence, times, with `motion`, the probability that the step ahead goes as it should in all
    cells that have less room than one and a half cells.
    """
    path = Path(xy=xy)
    points = (path.xy - grid.origin) / grid.cell - 0.5
    cells = np.clip(np.rint(points).astype(int), 0, np.array(grid.shape) - 1)
    slope = np.array([[sample(ground.slope[..., axis], x, y) for axis in range(2)] for x, y in points])
    headings = np.array([path.at(s)[2] for s in path.arc_length])
    ahead = np.column_stack([np.cos(headings), np.sin(headings)])
    along = (slope * ahead).sum(axis=1)
    across = slope[:, 1] * ahead[:, 0] - slope[:, 0] * ahead[:, 1]
    speed = np.minimum(config.speed, config.turn_rate / np.maximum(np.abs(path.curvature), 1e-9))
    speed /= 1 + config.slope_slowdown * (slope**2).sum(axis=1)
    steps = np.diff(path.arc_length)
    times = steps * 0.5 * (1 / speed[:-1] + 1 / speed[1:])
    turn = 0.0 if heading is None else abs(np.angle(np.exp(1j * (headings[0] - heading)))) / config.turn_rate
    rate = np.nan_to_num(grid.dose_rate[tuple(cells.T)].astype(float), nan=0.0)
    dose = rate[0] * turn + (0.5 * (rate[:-1] + rate[1:]) * times).sum()
    room = clearance_along(path.xy, grid)
    z = ground.height[tuple(cells.T)]
    costs = ground.weight[tuple(cells.T)]
    return Route(
        xy=path.xy,
        z=z,
        time_s=float(turn + times.sum()),
        clearance_m=float(room.min()),
        dose=float(dose / 3600),
        steepest_rad=float(np.arctan(np.abs(along).max())),
        tilt_rad=float(np.arctan(np.abs(across).max())),
        confidence=_seen_share(cells, grid, config.look) * _sure_steps(cells, room, grid, motion),
        cost=float((0.5 * (costs[:-1] + costs[1:]) * steps).sum()),
        signature=islands.signature(grid, path.xy),
        sides=_sides_in_words(path.xy, grid, islands),
    )


def _seen_share(cells: np.ndarray, grid: RouteGrid, look: float) -> float:
    """Share of the cells within `look` [m] of the route that are neither unknown nor fence."""
    reach = round(look / grid.cell)
    span = np.arange(-reach, reach + 1)
    disc = np.array([(i, j) for i in span for j in span if i * i + j * j <= reach * reach])
    around = np.unique((cells[:, None] + disc).reshape(-1, 2), axis=0)
    around = around[((around >= 0) & (around < grid.shape)).all(axis=1)]
    return float(1 - np.isin(grid.kind[tuple(around.T)], (UNKNOWN, FENCE)).mean())


def _sure_steps(cells: np.ndarray, room: np.ndarray, grid: RouteGrid, motion: MotionModel | None) -> float:
    """Probability that no step goes wrong where there is little room."""
    if motion is None:
        return 1.0
    narrow = cells[room < _NARROW * grid.cell]
    terrain = grid.terrain[tuple(np.unique(narrow, axis=0).T)]
    as_meant = np.where(motion.veer[:, FORWARD] == 0, motion.probability[:, FORWARD], 0.0).sum(axis=1)
    return float(as_meant[terrain].prod())


def _sides_in_words(xy: np.ndarray, grid: RouteGrid, islands: Islands) -> tuple[str, ...]:
    """Hazards that are passed, and on which side; numbered in the order of `Islands` where a kind is there twice."""
    words, sides = [], islands.sides(grid, xy)
    for k, side in enumerate(sides):
        kind = islands.hazard[k]
        if side and kind:
            alike = np.flatnonzero(islands.hazard == kind)
            number = f" {int(np.searchsorted(alike, k)) + 1}" if len(alike) > 1 else ""
            words.append(f"{side} of {KINDS[kind]}{number}")
    return tuple(words)
