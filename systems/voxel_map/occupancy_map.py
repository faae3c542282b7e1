"""The voxel map of a survey as a LeafSystem: keyframes in, free and occupied space out."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from ..config import check_config, quantity
from ..ports import eval_typed, weak_method
from ..slam.keyframe import Keyframe, KeyframePoses
from .submaps import SubmapCollection, SubmapConfig


@dataclass(kw_only=True)
class OccupancyMapConfig(SubmapConfig):
    """How the voxel map of a survey is kept."""

    # [s] Interval at which a new keyframe is looked for; that of the scan matcher or shorter, or keyframes are missed.
    period: float = quantity(0.1, unit="s", above=0)


@dataclass(frozen=True, eq=False)
class _State:
    """Abstract state; read-only, so that Drake may share it instead of copying it at every update.

    Attributes:
        submaps: all keyframes but the newest.
        newest: the one that is still open.
        corrected: the corrected poses that came last.
    """

    submaps: SubmapCollection
    newest: Keyframe | None = None
    corrected: KeyframePoses = field(default_factory=KeyframePoses)

    def __deepcopy__(self, memo: dict) -> "_State":
        return self


class OccupancyMap(LeafSystem):
    """
    .. pydrake_system::

        name: OccupancyMap
        input_ports:
        - keyframe
        - keyframe_poses
        output_ports:
        - voxel_map
        - occupied_M

    Keeps a map of voxels of all that the keyframes saw, in sub-maps that move with the pose graph.

    - `keyframe` (`Keyframe`): is added once for each index, see `VoxelMap.insert_cloud`: its points are occupied, and
      free is what lies between them and the LiDAR. The newest stays open: as long as no other index comes, a later
      version of it, to which a camera has added what it saw, takes its place.
    - `keyframe_poses` (optional, `KeyframePoses`): corrected poses. Sub-maps move with their first keyframe, see
      `SubmapCollection`. A keyframe that has none stays where it says it is, and so do all without this port, which is
      there with `with_corrections`.
    - `voxel_map` (`VoxelMap`, frozen): log-odds, classes and channel means in the map frame M. Put together only when
      it is asked for, at the cost of `SubmapCollection.compose`.
    - `occupied_M` (`open3d.t.geometry.PointCloud`): `VoxelMap.to_cloud` of it.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PortError: an input is not connected or of another type.
    """

    def __init__(
        self,
        config: OccupancyMapConfig | None = None,
        *,
        p_BS: np.ndarray | None = None,
        with_corrections: bool = False,
    ):
        """
        Args:
            p_BS: position of the LiDAR in the base B (3,) [m]; zero when not given.
            with_corrections: whether there is a port `keyframe_poses`.
        """
        super().__init__()
        config = config or OccupancyMapConfig()
        check_config(config, where="occupancy_map")
        self._p_BS = np.zeros(3) if p_BS is None else np.asarray(p_BS, float)
        self.DeclareAbstractInputPort("keyframe", AbstractValue.Make(object()))
        if with_corrections:
            self.DeclareAbstractInputPort("keyframe_poses", AbstractValue.Make(object()))
        self._with_corrections = with_corrections
        empty = SubmapCollection(config)
        ticket = self.abstract_state_ticket(self.DeclareAbstractState(AbstractValue.Make(_State(empty))))
        self.DeclarePeriodicUnrestrictedUpdateEvent(config.period, 0.0, self._Update)
        self.DeclareAbstractOutputPort(
            "voxel_map", lambda: AbstractValue.Make(empty.compose()), weak_method(self._CalcVoxelMap), {ticket}
        )
        self.DeclareAbstractOutputPort(
            "occupied_M", lambda: AbstractValue.Make(PointCloud()), weak_method(self._CalcOccupied), {ticket}
        )

    def _Update(self, context: Context, state: State) -> EventStatus:
        before = self._state(context)
        after = self._with_keyframe(before, eval_typed(self, context, "keyframe", Keyframe))
        if self._with_corrections:
            corrected = eval_typed(self, context, "keyframe_poses", KeyframePoses)
            if corrected is not after.corrected:
                submaps = after.submaps.correct(corrected.poses)
                after = replace(after, submaps=submaps, corrected=corrected)
        if after is before:
            return EventStatus.DidNothing()
        state.get_mutable_abstract_state(0).set_value(after)
        return EventStatus.Succeeded()

    def _with_keyframe(self, known: _State, keyframe: Keyframe) -> _State:
        newest = known.newest
        if keyframe.index < 0 or keyframe is newest or (newest is not None and keyframe.index < newest.index):
            return known
        submaps = known.submaps
        if newest is not None and keyframe.index > newest.index:
            submaps = self._insert(known)
        return replace(known, submaps=submaps, newest=keyframe)

    def _insert(self, known: _State) -> SubmapCollection:
        """All sub-maps with the newest keyframe in them."""
        newest = known.newest
        if newest is None:
            return known.submaps
        return known.submaps.insert(newest.index, newest.cloud_B, known.corrected.of(newest), self._p_BS)

    @staticmethod
    def _state(context: Context) -> _State:
        held: Any = context.get_abstract_state(0)
        return held.get_value()

    def _CalcVoxelMap(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._insert(self._state(context)).compose())

    def _CalcOccupied(self, context: Context, output: AbstractValue) -> None:
        voxels: Any = self.GetOutputPort("voxel_map").Eval(context)
        output.set_value(voxels.to_cloud())
