"""The way to the goal over remembered ground: a wavefront from the goal, and the point on the way to steer for."""

import math
from dataclasses import dataclass

import numpy as np

from ..config import quantity
from .ability import Ability
from .risk_map import IMPASSABLE
from .wavefront_kernels import costs_to_goal, descend, line, obstacle_distance, prices

# A mark counts only where nothing was seen, or over what was seen too.
IF_UNSEEN, ALWAYS = 0.0, 1.0


@dataclass(kw_only=True)
class WavefrontConfig:
    """How the way to the goal is priced."""

    # [-] Price of unseen ground; ground at risk r costs 1 / (1 - r / r_limit), that is 1.4 at 17 of 60.
    unknown_price: float = quantity(2.0, unit="-", low=1)
    # [-] Least share of speed that ground is priced with, so that no price is above its inverse.
    min_share: float = quantity(0.1, unit="-", above=0, high=1)
    # [m] Kept from obstacles beyond half the robot's width; over the next `comfort` the price rises to `narrow_price`
    # times itself: where it is narrow a long robot cannot turn, and on slopes it slides and leans against things.
    clearance: float = quantity(0.05, unit="m", low=0)
    comfort: float = quantity(0.25, unit="m", above=0)
    narrow_price: float = quantity(4.0, unit="-", low=1)
    # [-] Ground along the way so far is cheaper by this share: what is seen next may change the order of two ways that
    # cost the same, and a robot that follows each time gets nowhere.
    loyalty: float = quantity(0.15, unit="-", low=0)
    # [m] Unseen border around what is remembered, so that there is a way around it.
    border: float = quantity(1.5, unit="m", low=0)


@dataclass(frozen=True, eq=False)
class CostField:
    """Cost to the goal from every cell, (nx, ny). Read-only.

    Attributes:
        cost: [m at price 1], infinite where there is no way.
        price: per length, infinite where the robot's centre cannot be. risk: NaN where it is not known.
        origin: (2,) [m], of the corner of cell (0, 0). cell: [m].
        goal: (2,) [m].
    """

    cost: np.ndarray
    price: np.ndarray
    risk: np.ndarray
    origin: np.ndarray
    cell: float
    goal: np.ndarray

    def __deepcopy__(self, memo: dict) -> "CostField":
        return self

    def line(self, start: np.ndarray, end: np.ndarray) -> tuple[float, float, bool]:
        """Cost [m at price 1], highest risk, and whether all is known along a straight line from `start` to `end`."""
        a, b = (start - self.origin) / self.cell, (end - self.origin) / self.cell
        cost, risk, known = line(self.price, self.risk, a[0], a[1], b[0], b[1])
        return cost * self.cell, risk, known

    def path(self, start: np.ndarray) -> np.ndarray:
        """Middles of the cells of the cheapest way from `start` (2,) [m] to the goal, (n, 2) [m]; empty without any."""
        i, j = np.floor((start - self.origin) / self.cell).astype(int)
        shape = self.cost.shape
        if not (0 <= i < shape[0] and 0 <= j < shape[1]) or not np.isfinite(self.cost[i, j]):
            return np.zeros((0, 2))
        cells = descend(self.cost, self.price, self.cell, i, j, 4 * sum(shape))
        return self.origin + (cells + 0.5) * self.cell


def spread_costs(
    risk: np.ndarray,
    origin: np.ndarray,
    cell: float,
    goal: np.ndarray,
    robot: np.ndarray,
    ability: Ability,
    config: WavefrontConfig,
    *,
    marks: np.ndarray | None = None,
    tolerance: float = 0.2,
    before: CostField | None = None,
) -> CostField:
    """Spreads a wavefront from the goal over ground of known risk.

    What is `IMPASSABLE` is an obstacle, and the robot's centre stays off it by half its width. Where the robot already
    is nearer than that it may leave, but not go nearer. Unseen ground is passable at a price, also around the grid. A
    goal outside is reached through the border, at that price. A goal that cannot be stood on is reached when one of the
    cells within `tolerance` is. Along the way of the field `before`, to the same goal, ground is cheaper by `loyalty`.

    Args:
        risk: (nx, ny), NaN where it is not known. origin: (2,) [m], of the corner of cell (0, 0). cell: [m].
        goal, robot: (2,) [m].
        marks: (n, 4) discs x, y, radius [m] that are taken for obstacles, and `IF_UNSEEN` or `ALWAYS`.
    """
    ring = int(np.ceil(config.border / cell)) + 1
    risk = np.pad(np.asarray(risk, np.float32), ring, constant_values=np.nan)
    origin = np.asarray(origin, float) - ring * cell
    _apply_marks(risk, origin, cell, np.zeros((0, 4)) if marks is None else marks)
    # A step marks the cells on both sides of it, so that its edge is at least a cell behind the outermost centre.
    hard = max((0.5 * min(ability.footprint) + config.clearance) / cell - 1, 0.5)
    soft = hard + config.comfort / cell
    distance = obstacle_distance(risk >= IMPASSABLE, soft + 1)
    price = prices(
        risk, distance, ability.risk_limit, config.min_share, config.unknown_price, hard, soft, config.narrow_price
    )
    if before is not None and (before.goal == goal).all():
        _discount(price, (before.path(robot) - origin) / cell, 1 + config.loyalty)
    _open_around_robot(price, risk, distance, (robot - origin) / cell, 0.5 * math.hypot(*ability.footprint) / cell)
    seeds, start = _seeds(price.shape, (goal - origin) / cell, max(tolerance / cell, 0.75), config.unknown_price)
    cost = costs_to_goal(price, seeds, start) * np.float32(cell)
    return CostField(cost, price, risk, origin, cell, np.array(goal, float))


def _discount(price: np.ndarray, path: np.ndarray, divisor: float) -> None:
    """Makes cells within three of a path [cells] cheaper, but none cheaper than 1."""
    along = np.zeros(price.shape, bool)
    cells = np.floor(path).astype(int)
    cells = cells[((cells >= 0) & (cells < price.shape)).all(axis=1)]
    along[tuple(cells.T)] = True
    near = obstacle_distance(along, 3.5) <= 3
    price[near] = np.maximum(price[near] / np.float32(divisor), 1)


def find_way(field: CostField, robot: np.ndarray, slack: float = 0.4) -> np.ndarray | None:
    """The point to steer for, (2,) [m]: the farthest on the way to the goal that a straight line reaches at no higher
    cost than the way; None when there is no way. The way goes in steps of 45°, such lines in any direction.

    From a cell that the robot should not be in, as after it slid, the nearest with a way within `slack` [m] counts, if
    no obstacle is between.
    """
    at = (robot - field.origin) / field.cell
    cell = np.floor(at).astype(int)
    shape = np.array(field.cost.shape)
    if (cell < 0).any() or (cell >= shape).any():
        return field.goal
    if not np.isfinite(field.cost[tuple(cell)]):
        return None if np.isfinite(field.price[tuple(cell)]) else _nearest_with_a_way(field, robot, slack)
    path = field.path(robot)
    if len(path) < 2:
        return field.goal
    i, j = np.floor((path - field.origin) / field.cell).astype(int).T
    left = field.cost[i, j]
    if np.hypot(*(field.goal - path[-1])) < 1.5 * field.cell:
        path[-1] = field.goal
    # The way starts in the middle of a cell, the line where the robot is.
    here = float(left[0]) + 0.7 * field.cell * float(field.price[tuple(cell)])
    n = len(path) - 1
    while n > 1:
        if field.line(robot, path[n])[0] <= here - left[n]:
            return path[n]
        n = min(n - 1, int(0.85 * n))
    return path[1]


def _nearest_with_a_way(field: CostField, robot: np.ndarray, slack: float) -> np.ndarray | None:
    cell = np.floor((robot - field.origin) / field.cell).astype(int)
    reach = math.ceil(slack / field.cell)
    low, high = np.maximum(cell - reach, 0), np.minimum(cell + reach + 1, field.cost.shape)
    near = np.argwhere(np.isfinite(field.cost[low[0] : high[0], low[1] : high[1]])) + low
    points = field.origin + (near + 0.5) * field.cell
    gap = np.hypot(*(points - robot).T)
    for n in np.argsort(gap):
        if gap[n] <= slack and field.line(robot, points[n])[1] < IMPASSABLE:
            return points[n]
    return None


def _apply_marks(risk: np.ndarray, origin: np.ndarray, cell: float, marks: np.ndarray) -> None:
    for x, y, radius, kind in marks:
        low = np.maximum(np.floor((np.array([x, y]) - radius - origin) / cell).astype(int), 0)
        high = np.maximum(np.ceil((np.array([x, y]) + radius - origin) / cell).astype(int) + 1, 0)
        part = risk[low[0] : high[0], low[1] : high[1]]
        i, j = np.indices(part.shape)
        inside = (
            np.hypot(origin[0] + (i + low[0] + 0.5) * cell - x, origin[1] + (j + low[1] + 0.5) * cell - y) <= radius
        )
        part[inside & (np.isnan(part) | (kind == ALWAYS))] = IMPASSABLE


def _open_around_robot(price: np.ndarray, risk: np.ndarray, distance: np.ndarray, at: np.ndarray, reach: float) -> None:
    """Lets the robot leave where it stands: blocked cells within `reach` that are no nearer to an obstacle than it is
    get the highest price."""
    i, j = np.floor(at).astype(int)
    if not (0 <= i < price.shape[0] and 0 <= j < price.shape[1]) or np.isfinite(price[i, j]):
        return
    low_i, low_j, size = max(i - int(reach) - 1, 0), max(j - int(reach) - 1, 0), 2 * int(reach) + 3
    part = (slice(low_i, low_i + size), slice(low_j, low_j + size))
    p, q = np.indices(price[part].shape)
    near = np.hypot(p + low_i + 0.5 - at[0], q + low_j + 0.5 - at[1]) <= reach
    opened = near & (distance[part] >= min(distance[i, j], 2.0)) & ~(risk[part] >= IMPASSABLE)
    opened |= (p + low_i == i) & (q + low_j == j)
    dearest = float(np.max(price, where=np.isfinite(price), initial=1.0))
    price[part] = np.where(opened & ~np.isfinite(price[part]), dearest, price[part])


def _seeds(shape: tuple[int, int], at: np.ndarray, reach: float, unknown: float) -> tuple[np.ndarray, np.ndarray]:
    """Flat indices and costs of the cells that the wavefront starts from: around the goal, or the border before it."""
    if (at >= 0).all() and (at < shape).all():
        spread = np.arange(-int(np.ceil(reach)) - 1, int(np.ceil(reach)) + 2)
        i, j = np.meshgrid(*(np.floor(x).astype(int) + spread for x in at), indexing="ij")
        cost = np.hypot(i + 0.5 - at[0], j + 0.5 - at[1])
        inside = (cost <= reach) & (i >= 0) & (j >= 0) & (i < shape[0]) & (j < shape[1])
        return (i[inside] * shape[1] + j[inside]).ravel(), cost[inside].ravel()
    edge = np.ones(shape, bool)
    edge[1:-1, 1:-1] = False
    i, j = np.nonzero(edge)
    return i * shape[1] + j, unknown * np.hypot(i + 0.5 - at[0], j + 0.5 - at[1])
