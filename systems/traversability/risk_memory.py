"""Memory of the risk that a robot has seen around it, in the map frame."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from ..config import check_config, quantity
from ..ports import eval_typed, weak_method
from ..tracking import planar_pose
from .ability import Ability, check_ability
from .risk_map import RiskMap, RiskMapConfig, make_risk_map

# Share of the remembered risk below which a measurement is lower, and not the same with noise.
_LOWER = 0.8


@dataclass(kw_only=True)
class RiskMemoryConfig:
    """How much is remembered, and when it gives way to what is seen now."""

    map: RiskMapConfig = field(default_factory=RiskMapConfig)
    # [s] How often a cloud is taken in.
    period: float = quantity(0.5, unit="s", above=0)
    # [m] Half the edge of the window around the robot that is judged anew.
    reach: float = quantity(5.0, unit="m", above=0)
    # [m] Longest edge of what is remembered; beyond it the far side is forgotten.
    longest: float = quantity(40.0, unit="m", above=0)
    # [s] Time in which the coverage of what is remembered counts half: a worse view replaces a better one then.
    half_life: float = quantity(5.0, unit="s", above=0)
    # A lower risk replaces a higher one when it was measured so often in a row: at the edge of an obstacle cells change
    # from scan to scan, and a gap that opens and closes keeps the robot from leaving by another.
    confirmations: int = quantity(3, unit="measurements", low=1)


@dataclass(frozen=True, eq=False)
class RiskGrid:
    """Remembered risk by cell, (nx, ny) float32 each. Read-only.

    Attributes:
        risk: r, NaN where nothing is known. coverage: share of the cell's window that was seen.
        time: of the measurement [s]. lower: how often in a row less risk was measured since.
        origin: (2,) in M, of the corner of cell (0, 0) [m], a whole number of cells. cell: [m].
        index: number of clouds taken in.
    """

    risk: np.ndarray
    coverage: np.ndarray
    time: np.ndarray
    lower: np.ndarray
    origin: np.ndarray
    cell: float
    index: int = 0

    def __deepcopy__(self, memo: dict) -> "RiskGrid":
        return self


def empty_grid(cell: float) -> RiskGrid:
    """A memory of nothing."""
    nothing = np.zeros((0, 0), np.float32)
    return RiskGrid(nothing, nothing, nothing, nothing, np.zeros(2), cell)


def remember(grid: RiskGrid, seen: RiskMap, time: float, config: RiskMemoryConfig) -> RiskGrid:
    """`grid` with the cells of `seen` taken in; its origin must be a whole number of cells too.

    A measurement replaces an older one when its coverage is no less, where that of the older one is halved every
    `half_life`, and a clearly lower risk only after `confirmations` of it in a row. What is not known in `seen` stays
    as it was. The grid grows as far as the map was seen; where that makes it longer than `longest`, the side away from
    `seen` is forgotten.
    """
    known = np.isfinite(seen.risk)
    if not known.any():
        return replace(grid, index=grid.index + 1)
    rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    part = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    low = np.rint(seen.origin / grid.cell).astype(int) + np.array([rows[0], columns[0]])
    high = low + known[part].shape
    first, last = low, high
    old = np.rint(grid.origin / grid.cell).astype(int)
    if grid.risk.size:
        longest = max(int(config.longest / grid.cell), 1)
        first, last = np.minimum(old, low), np.maximum(old + grid.risk.shape, high)
        down = low < old
        last = np.where(down, np.minimum(last, np.maximum(high, first + longest)), last)
        first = np.where(down, first, np.maximum(first, np.minimum(low, last - longest)))
    layers = [np.full(last - first, empty, np.float32) for empty in (np.nan, 0, -np.inf, 0)]
    if grid.risk.size:
        start, end = np.maximum(old, first), np.minimum(old + grid.risk.shape, last)
        if (start < end).all():
            to, of = _slices(start - first, end - first), _slices(start - old, end - old)
            for layer, before in zip(layers, (grid.risk, grid.coverage, grid.time, grid.lower), strict=True):
                layer[to] = before[of]
    risk, coverage, stamp, lower = (layer[_slices(low - first, high - first)] for layer in layers)
    aged = coverage * np.exp2((stamp - time) / config.half_life)
    newer = known[part] & ((seen.coverage[part] >= aged) | np.isnan(risk))
    lower[newer] = np.where(seen.risk[part] < _LOWER * risk, lower + 1, 0)[newer]
    newer &= (lower == 0) | (lower >= config.confirmations)
    risk[newer], coverage[newer], stamp[newer] = seen.risk[part][newer], seen.coverage[part][newer], time
    lower[newer] = 0
    return RiskGrid(layers[0], layers[1], layers[2], layers[3], first * grid.cell, grid.cell, grid.index + 1)


def _slices(start: np.ndarray, end: np.ndarray) -> tuple[slice, slice]:
    return slice(start[0], end[0]), slice(start[1], end[1])


class RiskMemory(LeafSystem):
    """
    .. pydrake_system::

        name: RiskMemory
        input_ports:
        - cloud_H
        - X_MB
        output_ports:
        - risk_memory

    Remembers the risk of the ground that the robot has seen, so that what lies behind or below it is not forgotten.
    Every `period` the cloud is turned into the map, the window around the robot is judged by `make_risk_map`, and taken
    in by `remember`.

    - `cloud_H` (`open3d.t.geometry.PointCloud`): in the heading frame, see `TerrainFeatures`.
    - `X_MB` (RigidTransform): pose of the robot's base in the map.
    - `risk_memory` (`RiskGrid`): what is known so far; empty before the first cloud.

    Raises:
        ConfigError: a value of the configuration or of the ability cannot be used.
        PortError: an input is not connected or of another type.
    """

    def __init__(self, ability: Ability, config: RiskMemoryConfig | None = None):
        super().__init__()
        self._ability, self._config = ability, config or RiskMemoryConfig()
        check_ability(ability)
        check_config(self._config, where="risk memory")
        self.DeclareAbstractInputPort("cloud_H", AbstractValue.Make(object()))
        self.DeclareAbstractInputPort("X_MB", AbstractValue.Make(RigidTransform()))
        start = empty_grid(self._config.map.surface.cell)
        state = self.abstract_state_ticket(self.DeclareAbstractState(AbstractValue.Make(start)))
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._config.period, 0.0, self._Remember)
        self.DeclareAbstractOutputPort(
            "risk_memory", lambda: AbstractValue.Make(start), weak_method(self._CalcMemory), {state}
        )

    @staticmethod
    def _grid(context: Context) -> RiskGrid:
        held: Any = context.get_abstract_state(0)
        return held.get_value()

    def _Remember(self, context: Context, state: State) -> EventStatus:
        cloud = eval_typed(self, context, "cloud_H", PointCloud)
        pose, grid = planar_pose(eval_typed(self, context, "X_MB", RigidTransform)), self._grid(context)
        points = cloud.point.positions.numpy() if "positions" in cloud.point else np.zeros((0, 3), np.float32)
        seen = see(points, pose, self._ability, self._config)
        state.get_mutable_abstract_state(0).set_value(remember(grid, seen, context.get_time(), self._config))
        return EventStatus.Succeeded()

    def _CalcMemory(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._grid(context))


def see(p_H: np.ndarray, pose: np.ndarray, ability: Ability, config: RiskMemoryConfig) -> RiskMap:
    """Risk of the window around a robot at `pose` (x, y, heading in M), in cells that are aligned with M.

    Args:
        p_H: (N, 3) [m].
    """
    c, s = np.cos(pose[2]), np.sin(pose[2])
    X = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]], np.float32)
    points = np.asarray(p_H, np.float32) @ X.T + np.array([pose[0], pose[1], 0.0], np.float32)
    cell = config.map.surface.cell
    half = int(np.ceil(config.reach / cell))
    origin = (np.floor(pose[:2] / cell) - half) * cell
    return make_risk_map(points, ability, config.map, origin=origin, shape=(2 * half + 1, 2 * half + 1))
