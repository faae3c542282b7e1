"""The localiser as a system: laser scans and odometry in, pose and how far to trust it out."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, LeafSystem, State

from ..errors import ConfigError
from ..ports import eval_typed, weak_method
from .laser_scan import LaserScan
from .localizer_config import LocalizerConfig
from .occupancy_grid import OccupancyGrid
from .planar import between, compose, from_matrix, to_matrix
from .scan_localization import Localization, localize, start_localization

# [s] Scans are looked for so long after the full period: of what happens at one instant, Drake shows every system the
# state from before, and a scan that ends then would be taken a whole period late, with the odometry of then.
_AFTER_SCAN = 1e-3


@dataclass(frozen=True, eq=False)
class _Held:
    """Abstract state; read-only, so that Drake may share it: `time` and `X_OB` are those of the last look."""

    known: Localization
    index: int = -1
    time: float = 0.0
    X_OB: np.ndarray | None = None

    def __deepcopy__(self, memo: dict) -> "_Held":
        return self


class EvolutionLocalizer(LeafSystem):
    """
    .. pydrake_system::

        name: EvolutionLocalizer
        input_ports:
        - laser_scan
        - X_OB
        output_ports:
        - X_MB
        - pose
        - covariance
        - health
        - lost
        - grid
        - localization

    Finds the robot (base B) in a 2D map (frame M) by fitting every scan of a 2D laser to it with an evolution strategy
    (row S4-g), refined by Gauss-Newton on the likelihood field and fused with odometry; see `localize`. The map is the
    one that was given, or grows on the way when `config.mapping` is set.

    - `laser_scan` (`LaserScan`): looked at 1 ms after every `period`; one with the index of the last, or -1, is
      ignored.
    - `X_OB` (RigidTransform): odometry, from any origin O; of it x, y and heading are used.
    - `X_MB` (RigidTransform), `pose` (3): x, y, heading in M [m, m, rad]. Between scans they go on with odometry.
    - `covariance` (9): of the last scan's pose, in the axes of M, row by row [m², m rad, rad²]. It grows along a bare
      corridor, where the fitness does not fall. With `method: paper` it is only the spread of the last population.
    - `health` (1): fitness of the last scan, in [0, 1]; 0 when it had too few returns on the map.
    - `lost` (1): 1 when the position may be off by more than `lost_deviation`, or several scans in a row did not fit.
    - `grid` (`OccupancyGrid`): the map.
    - `localization` (`Localization`): all of it.

    At the first look the pose is the start.

    Args:
        grid: the map that is known, such as a floor plan; none when not given, which needs `config.mapping`.
        start: X_MB of the start, (3,), zero when not given.
        X_BS: pose of the laser on the robot, (3,), zero when not given.
        period: [s] at which a new scan is looked for.
        seed: of the evolution; two runs with one seed are equal.

    Raises:
        ConfigError: a value of `config` is out of range, or there is neither a map nor mapping.
        PortError: an input is not connected or of another type.
    """

    def __init__(
        self,
        config: LocalizerConfig | None = None,
        *,
        grid: OccupancyGrid | None = None,
        start: np.ndarray | None = None,
        X_BS: np.ndarray | None = None,
        period: float = 0.1,
        seed: int = 0,
    ):
        super().__init__()
        self._config = config or LocalizerConfig()
        first = start_localization(self._config, grid, start)
        if not self._config.mapping and not first.grid.occupied.any():
            raise ConfigError(
                "nothing to localise in", where="localizer", key="grid", valid="a map with walls, or mapping: true"
            )
        if not (math.isfinite(period) and period > 0):
            raise ConfigError("out of range", where="localizer", key="period", value=period, valid="> 0 s")
        self._X_BS, self._seed = X_BS, seed
        self.DeclareAbstractInputPort("laser_scan", AbstractValue.Make(object()))
        odometry = self.DeclareAbstractInputPort("X_OB", AbstractValue.Make(RigidTransform()))
        self._state = self.DeclareAbstractState(AbstractValue.Make(_Held(first)))
        state = self.abstract_state_ticket(self._state)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, _AFTER_SCAN, self._TakeScan)
        self.DeclareAbstractOutputPort(
            "X_MB",
            lambda: AbstractValue.Make(RigidTransform()),
            weak_method(self._CalcX_MB),
            {state, odometry.ticket()},
        )
        self.DeclareVectorOutputPort("pose", 3, self._CalcPose, {state, odometry.ticket()})
        self.DeclareVectorOutputPort("covariance", 9, self._CalcCovariance, {state})
        self.DeclareVectorOutputPort("health", 1, self._CalcHealth, {state})
        self.DeclareVectorOutputPort("lost", 1, self._CalcLost, {state})
        self.DeclareAbstractOutputPort(
            "grid", lambda: AbstractValue.Make(first.grid), weak_method(self._CalcGrid), {state}
        )
        self.DeclareAbstractOutputPort(
            "localization", lambda: AbstractValue.Make(first), weak_method(self._CalcLocalization), {state}
        )

    def _held(self, context: Context) -> _Held:
        held: Any = context.get_abstract_state(int(self._state))
        return held.get_value()

    def _known(self, context: Context) -> Localization:
        return self._held(context).known

    def _odometry(self, context: Context) -> np.ndarray:
        return from_matrix(eval_typed(self, context, "X_OB", RigidTransform).GetAsMatrix4())

    def _TakeScan(self, context: Context, state: State) -> None:
        scan = eval_typed(self, context, "laser_scan", LaserScan)
        before, now, X_OB = self._held(context), context.get_time(), self._odometry(context)
        known, index = before.known, before.index
        if known.X_OB is None:
            # A robot that drives off at once is no longer at its start when the first scan comes.
            known = replace(known, X_OB=X_OB, time=now)
        if scan.index not in (-1, index):
            X_OS = X_OB
            if before.X_OB is not None and before.time < scan.time < now:
                part = (scan.time - before.time) / (now - before.time)
                X_OS = compose(before.X_OB, part * between(before.X_OB, X_OB))
            known, index = localize(known, scan, X_OS, self._config, X_BS=self._X_BS, seed=self._seed), scan.index
        held: Any = state.get_mutable_abstract_state(int(self._state))
        held.set_value(_Held(known, index, now, X_OB))

    def _pose(self, context: Context) -> np.ndarray:
        """The last scan's pose, and the odometry since."""
        known = self._known(context)
        if known.X_OB is None:
            return known.pose
        return compose(known.pose, between(known.X_OB, self._odometry(context)))

    def _CalcX_MB(self, context: Context, output: AbstractValue) -> None:
        output.set_value(RigidTransform(to_matrix(self._pose(context))))

    def _CalcPose(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._pose(context))

    def _CalcCovariance(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._known(context).covariance.ravel())

    def _CalcHealth(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array([self._known(context).health]))

    def _CalcLost(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array([float(self._known(context).lost)]))

    def _CalcGrid(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._known(context).grid)

    def _CalcLocalization(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._known(context))
