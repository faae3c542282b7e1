"""LeafSystem that turns the semantic map into what routes are planned and learnt on."""

import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from ..config import check_config
from ..ports import eval_typed, weak_method
from ..traversability import Ability, check_ability
from .interest import make_interest
from .make_grid import make_route_grid
from .route_grid import UNKNOWN, RouteGrid
from .voxels import Voxels, make_voxels
from .world_config import VoxelWorldConfig


@dataclass(frozen=True, eq=False)
class _World:
    """Abstract state; read-only.

    Attributes:
        grid, voxels, interest: of the map as it was last looked at.
        seen: number of keyframes then, and checksum of their poses. newest: cloud of the newest of them.
    """

    grid: RouteGrid
    voxels: Voxels
    interest: np.ndarray
    seen: tuple[int, int] = (0, 0)
    newest: PointCloud | None = None

    def __deepcopy__(self, memo: dict) -> "_World":
        return self


class VoxelWorld(LeafSystem):
    """
    .. pydrake_system::

        name: VoxelWorld
        input_ports:
        - semantic_M
        - keyframes
        output_ports:
        - route_grid
        - voxels
        - interest

    The world for route learning (row S0-h): the semantic map as voxels and as a grid of cells that can be entered or
    not, see `make_route_grid` and `make_voxels`.

    - `semantic_M` (`open3d.t.geometry.PointCloud`): as from `SemanticMap`, with `label` and `dose_rate` if known.
    - `keyframes` (tuple of `Keyframe`): as from `SurveyMap`: where the robot stood, and whether the map has changed.
    - `route_grid` (`RouteGrid`): one unknown cell before there is a map. The same object as before when a new map
      says the same, so that whoever learns on it goes on.
    - `voxels` (`Voxels`): every voxel with points, and its kind.
    - `interest` (array (nx, ny) [bit]): what a look at each cell of the grid would tell, see `make_interest`.

    Every `period` it is looked whether keyframes have come, have moved or were added to by a camera; only then the map
    is evaluated.

    Raises:
        ConfigError: a value of the configuration or of the ability is out of range.
        PortError: an input is not connected or of another type.
    """

    def __init__(self, config: VoxelWorldConfig | None = None, *, ability: Ability | None = None):
        """
        Args:
            ability: what the robot drives over; without, the floor is flat, as in the paper.
        """
        super().__init__()
        self._config, self._ability = config or VoxelWorldConfig(), ability
        check_config(self._config, key="voxel_world")
        if ability is not None:
            check_ability(ability)
        self.DeclareAbstractInputPort("semantic_M", AbstractValue.Make(object()))
        self.DeclareAbstractInputPort("keyframes", AbstractValue.Make(object()))
        nothing = RouteGrid.from_kind(np.full((1, 1), UNKNOWN, np.uint8), self._config.risk.surface.cell)
        empty = Voxels(np.zeros((0, 3), np.int64), np.zeros(0, np.uint8), self._config.voxel)
        none = np.ones((1, 1), np.float32)
        state = self.DeclareAbstractState(AbstractValue.Make(_World(nothing, empty, none)))
        ticket = self.abstract_state_ticket(state)
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._config.period, 0.0, self._Look)
        self.DeclareAbstractOutputPort(
            "route_grid", lambda: AbstractValue.Make(nothing), weak_method(self._CalcGrid), {ticket}
        )
        self.DeclareAbstractOutputPort(
            "voxels", lambda: AbstractValue.Make(empty), weak_method(self._CalcVoxels), {ticket}
        )
        self.DeclareAbstractOutputPort(
            "interest", lambda: AbstractValue.Make(none), weak_method(self._CalcInterest), {ticket}
        )

    @staticmethod
    def _world(context: Context) -> _World:
        held: Any = context.get_abstract_state(0)
        return held.get_value()

    def _Look(self, context: Context, state: State) -> EventStatus:
        keyframes, before, config = eval_typed(self, context, "keyframes", tuple), self._world(context), self._config
        if not keyframes:
            return EventStatus.DidNothing()
        # Poses move when a loop closes; what a camera adds to the newest keyframe comes as a new cloud.
        poses = np.array([keyframe.X_MB.GetAsMatrix34() for keyframe in keyframes])
        seen, newest = (len(keyframes), zlib.crc32(poses.tobytes())), keyframes[-1].cloud_B
        if seen == before.seen and newest is before.newest:
            return EventStatus.DidNothing()
        cloud = eval_typed(self, context, "semantic_M", PointCloud)
        if "positions" not in cloud.point or not len(cloud.point.positions):
            return EventStatus.DidNothing()
        stood = poses[:, :2, 3]
        grid = make_route_grid(cloud, self._ability, config, stood=stood)
        step = self._ability.step_threshold if self._ability else config.step
        voxels = make_voxels(cloud, grid, voxel=config.voxel, max_dose_rate=config.max_dose_rate, step=step)
        if grid.fingerprint == before.grid.fingerprint:
            grid = before.grid
        interest = make_interest(cloud, grid)
        state.get_mutable_abstract_state(0).set_value(_World(grid, voxels, interest, seen, newest))
        return EventStatus.Succeeded()

    def _CalcGrid(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._world(context).grid)

    def _CalcVoxels(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._world(context).voxels)

    def _CalcInterest(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._world(context).interest)
