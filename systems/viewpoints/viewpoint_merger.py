"""Joins viewpoints as they arrive, without odometry."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import open3d as o3d
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from ..clouds import VoxelCloud
from ..config import check_config, quantity
from ..errors import PortError
from ..ports import eval_typed, weak_method
from ..sensing import Scan
from ..slam import Keyframe
from .viewpoint_set import NOTHING_MERGED, MergeConfig, MergeResult, ViewpointSet, check_lists, merge_viewpoints


@dataclass(kw_only=True)
class ViewpointMergerConfig:
    """How viewpoints are joined, and how their map is kept."""

    merge: MergeConfig = field(default_factory=MergeConfig)
    # [m] Edge length of a voxel of the map.
    voxel_size: float = quantity(0.1, unit="m", above=0)
    # [s] Interval at which a new view is looked for; that of its source or shorter, or views are missed.
    period: float = quantity(0.1, unit="s", above=0)


class ViewpointMerger(LeafSystem):
    """
    .. pydrake_system::

        name: ViewpointMerger
        input_ports:
        - view
        - rpy
        output_ports:
        - merge
        - merged_M
        - poses

    Joins views of one place that were taken metres apart, without odometry and without a guess, see
    `merge_viewpoints` (S0-d). All the work is done when a view with a new index arrives: it is searched against those
    that are there, and which of them belong together is decided anew.

    - `view`: a `Scan` of a robot that stands still, points in the sensor frame S, or a `Keyframe`, points in the base
      B; an index below zero is no view.
    - `rpy` (3): roll, pitch and yaw of S, or B, at that instant [rad]; roll and pitch level the view. An input that is
      optional: without `with_rpy`, views are level.
    - `merge` (`MergeResult`): which views are joined, how they lie, how sure that is, and why others are not.
    - `merged_M` (`PointCloud`): the joined views in the map frame M [m], one mean point a voxel with the means of all
      attributes, see `VoxelCloud`; put together when it is asked for.
    - `poses` (dict of `RigidTransform` by index): X_MS, or X_MB, of the joined views.

    M is the levelled frame of the joined view with the lowest index: it changes only if that view does.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PortError: an input is not connected or of another type.
    """

    def __init__(
        self,
        config: ViewpointMergerConfig | None = None,
        *,
        X_BS: RigidTransform | None = None,
        with_rpy: bool = False,
    ):
        """
        Args:
            X_BS: pose of the sensor in B, for keyframes: what a view saw through is counted from there.
            with_rpy: whether there is an input `rpy`.
        """
        super().__init__()
        self._config = config or ViewpointMergerConfig()
        check_config(self._config)
        check_lists(self._config.merge)
        self._p_BS = RigidTransform(X_BS or RigidTransform()).translation()
        self._with_rpy = with_rpy
        self.DeclareAbstractInputPort("view", AbstractValue.Make(object()))
        if with_rpy:
            self.DeclareVectorInputPort("rpy", 3)
        state = self.DeclareAbstractState(AbstractValue.Make(ViewpointSet(self._config.merge)))
        ticket = self.abstract_state_ticket(state)
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._config.period, 0.0, self._AddView)
        self.DeclareAbstractOutputPort(
            "merge", lambda: AbstractValue.Make(NOTHING_MERGED), weak_method(self._CalcMerge), {ticket}
        )
        self.DeclareAbstractOutputPort(
            "merged_M", lambda: AbstractValue.Make(_no_points()), weak_method(self._CalcMap), {ticket}
        )
        self.DeclareAbstractOutputPort("poses", lambda: AbstractValue.Make({}), weak_method(self._CalcPoses), {ticket})

    def _AddView(self, context: Context, state: State) -> EventStatus:
        view: Any = eval_typed(self, context, "view", object)
        if not isinstance(view, (Scan, Keyframe)):
            where = f"{type(self).__name__}.view"
            raise PortError("wrong type", where=where, value=type(view).__name__, valid="Scan or Keyframe")
        known = self._views(context)
        if view.index < 0 or view.index in known.views:
            return EventStatus.DidNothing()
        rpy = None
        if self._with_rpy:
            port = self.GetInputPort("rpy")
            if not port.HasValue(context):
                raise PortError("input port is not connected", where=f"{type(self).__name__}.rpy", valid="3 angles")
            rpy = np.asarray(port.Eval(context), float)
        if isinstance(view, Scan):
            grown = known.add(view.index, view.cloud_S, rpy)
        else:
            grown = known.add(view.index, view.cloud_B, rpy, self._p_BS)
        state.get_mutable_abstract_state(0).set_value(grown.solve())
        return EventStatus.Succeeded()

    @staticmethod
    def _views(context: Context) -> ViewpointSet:
        held: Any = context.get_abstract_state(0)
        return held.get_value()

    def _CalcMerge(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._views(context).result)

    def _CalcMap(self, context: Context, output: AbstractValue) -> None:
        views = self._views(context)
        voxels = VoxelCloud(self._config.voxel_size)
        for index, X_MS in views.result.poses.items():
            voxels = voxels.insert(views.clouds[index], X_MS.GetAsMatrix4())
        output.set_value(voxels.to_cloud())

    def _CalcPoses(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._views(context).result.poses)


def _no_points() -> PointCloud:
    return PointCloud(o3d.core.Tensor(np.zeros((0, 3), np.float32)))


__all__ = ["MergeConfig", "MergeResult", "ViewpointMerger", "ViewpointMergerConfig", "merge_viewpoints"]
