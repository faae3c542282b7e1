"""The survey map: every keyframe at its pose, in one voxel cloud."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import open3d as o3d
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from ..clouds import VoxelCloud
from ..config import check_config, quantity
from ..ports import eval_typed, weak_method
from .keyframe import Keyframe, KeyframePoses


@dataclass(kw_only=True)
class SurveyMapConfig:
    """How the survey map is kept."""

    # [m] Edge length of a voxel; S0-h plans on 0.1 m.
    voxel_size: float = quantity(0.1, unit="m", above=0)
    # [s] Interval at which a new keyframe is looked for; that of the scan matcher or shorter, or keyframes are missed.
    period: float = quantity(0.1, unit="s", above=0)


@dataclass(frozen=True, eq=False)
class _Map:
    """Abstract state; read-only, so that Drake may share it instead of copying it at every update.

    Attributes:
        voxels: all keyframes but the newest.
        keyframes: all of them.
        poses_version: of the corrections that are applied to both.
    """

    voxels: VoxelCloud
    keyframes: tuple[Keyframe, ...] = ()
    poses_version: int = 0

    def __deepcopy__(self, memo: dict) -> "_Map":
        return self


class SurveyMap(LeafSystem):
    """
    .. pydrake_system::

        name: SurveyMap
        input_ports:
        - keyframe
        - keyframe_poses
        output_ports:
        - map_M
        - keyframes

    Adds every `keyframe` (`Keyframe`), once for each index, at its X_MB to a grid of voxels. `map_M` is the cloud
    of their mean positions in the map frame M [m], with the mean of every attribute and the `count` of keyframe
    points (`open3d.t.geometry.PointCloud`, see `VoxelCloud`); it is put together only when it is asked for.
    `keyframes` (tuple of `Keyframe`) is what it was made of, in the order of arrival.

    `keyframe_poses` (`KeyframePoses`) is where a pose graph finds the keyframes to be; this optional port is there with
    `with_corrections`. When its version changes, all keyframes are laid out anew, about 4 ms each.

    The newest keyframe stays open: as long as no other index comes, a later version of it, to which a camera has added
    what it saw, takes its place. A keyframe arrives one period after it was made, because all update at the same
    instants.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PortError: the input is not connected or of another type.
    """

    def __init__(self, config: SurveyMapConfig | None = None, *, with_corrections: bool = False):
        super().__init__()
        config = config or SurveyMapConfig()
        check_config(config)
        self._with_corrections = with_corrections
        self.DeclareAbstractInputPort("keyframe", AbstractValue.Make(object()))
        if with_corrections:
            self.DeclareAbstractInputPort("keyframe_poses", AbstractValue.Make(KeyframePoses()))
        start = _Map(VoxelCloud(config.voxel_size))
        ticket = self.abstract_state_ticket(self.DeclareAbstractState(AbstractValue.Make(start)))
        self.DeclarePeriodicUnrestrictedUpdateEvent(config.period, 0.0, self._AddKeyframe)
        self.DeclareAbstractOutputPort(
            "map_M", lambda: AbstractValue.Make(_no_points()), weak_method(self._CalcMap), {ticket}
        )
        self.DeclareAbstractOutputPort(
            "keyframes", lambda: AbstractValue.Make(()), weak_method(self._CalcKeyframes), {ticket}
        )

    def _AddKeyframe(self, context: Context, state: State) -> EventStatus:
        keyframe = eval_typed(self, context, "keyframe", Keyframe)
        before = known = self._map(context)
        if self._with_corrections:
            poses = eval_typed(self, context, "keyframe_poses", KeyframePoses)
            known = _corrected(known, poses)
            (keyframe,) = poses.moved((keyframe,))
        newest = known.keyframes[-1] if known.keyframes else None
        if keyframe.index >= 0 and (newest is None or keyframe.index > newest.index):
            known = replace(known, voxels=_insert(known.voxels, newest), keyframes=(*known.keyframes, keyframe))
        elif newest is not None and keyframe.index == newest.index and keyframe.cloud_B is not newest.cloud_B:
            known = replace(known, keyframes=(*known.keyframes[:-1], keyframe))
        if known is before:
            return EventStatus.DidNothing()
        state.get_mutable_abstract_state(0).set_value(known)
        return EventStatus.Succeeded()

    @staticmethod
    def _map(context: Context) -> _Map:
        held: Any = context.get_abstract_state(0)
        return held.get_value()

    def _CalcMap(self, context: Context, output: AbstractValue) -> None:
        known = self._map(context)
        output.set_value(_insert(known.voxels, known.keyframes[-1] if known.keyframes else None).to_cloud())

    def _CalcKeyframes(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._map(context).keyframes)


def _corrected(known: _Map, poses: KeyframePoses) -> _Map:
    """The map with its keyframes at `poses`."""
    if poses.version == known.poses_version:
        return known
    keyframes = poses.moved(known.keyframes)
    voxels = VoxelCloud(known.voxels.voxel)
    for keyframe in keyframes[:-1]:
        voxels = _insert(voxels, keyframe)
    return _Map(voxels, keyframes, poses.version)


def _insert(voxels: VoxelCloud, keyframe: Keyframe | None) -> VoxelCloud:
    return voxels if keyframe is None else voxels.insert(keyframe.cloud_B, keyframe.X_MB.GetAsMatrix4())


def _no_points() -> PointCloud:
    return PointCloud(o3d.core.Tensor(np.zeros((0, 3), np.float32)))
