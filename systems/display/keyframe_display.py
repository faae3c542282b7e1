"""Keyframes in Meshcat: the map grows as the robot drives, also in a recording."""

from dataclasses import dataclass

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import Meshcat, Rgba
from pydrake.perception import BaseField, Fields
from pydrake.perception import PointCloud as DrakePointCloud
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from ..config import check_config, quantity
from ..ports import eval_typed
from ..slam import Keyframe
from .colours import height_colours


@dataclass(kw_only=True)
class KeyframeDisplayConfig:
    """How keyframes are drawn."""

    # Period at which a new keyframe is looked for [s].
    period: float = quantity(0.1, unit="s", above=0)
    # At most this many points a keyframe are kept in the map that is drawn.
    points_per_keyframe: int = quantity(2500, low=1)
    # Edge length of a point [m].
    point_size: float = quantity(0.04, unit="m", above=0)
    # Points higher than this over the floor are not drawn, so that one can look into a room [m].
    max_height: float = quantity(2.2, unit="m")


def drake_cloud(points: np.ndarray, colours: np.ndarray | None = None) -> DrakePointCloud:
    """A Drake cloud for Meshcat, half the size without colours. points: (N, 3) [m]; colours: (3, N) uint8."""
    has = BaseField.kXYZs if colours is None else BaseField.kXYZs | BaseField.kRGBs
    cloud = DrakePointCloud(len(points), Fields(has))
    cloud.mutable_xyzs()[:] = points.T
    if colours is not None:
        cloud.mutable_rgbs()[:] = colours
    return cloud


def points_in_map(keyframe: Keyframe) -> np.ndarray:
    """Points of a keyframe in M, (N, 3) [m], where its X_MB puts them."""
    return keyframe.p_BP @ keyframe.X_MB.rotation().matrix().T + keyframe.X_MB.translation()


def show_from(
    meshcat: Meshcat, path: str, cloud: DrakePointCloud, *, size: float, time: float, rgba: Rgba | None = None
) -> None:
    """Shows a cloud at `path`; in a recording, from `time` [s] on.

    Args:
        size: edge length of a point [m].
        rgba: colour of a cloud without colours, white when not given.
    """
    meshcat.SetObject(path, cloud, point_size=size, rgba=rgba or Rgba(1.0, 1.0, 1.0, 1.0))
    meshcat.SetProperty(path, "visible", False, 0.0)
    meshcat.SetProperty(path, "visible", True, time)


def show_newest_scan(
    meshcat: Meshcat, keyframe: Keyframe, points: np.ndarray, *, size: float, time: float, before: int
) -> None:
    """Shows points (N, 3) [m] of the newest keyframe in white, and hides those of keyframe `before` (-1: none)."""
    if len(points) > 0:
        show_from(meshcat, f"scan/{keyframe.index:05}", drake_cloud(points), size=1.5 * size, time=time)
    hide_scan(meshcat, before, time)


def hide_scan(meshcat: Meshcat, index: int, time: float) -> None:
    """Hides the white points of keyframe `index` (-1: none); in a recording, from `time` [s] on."""
    if index >= 0:
        meshcat.SetProperty(f"scan/{index:05}", "visible", False, time)


class KeyframeDisplay(LeafSystem):
    """
    .. pydrake_system::

        name: KeyframeDisplay
        input_ports:
        - keyframe

    Draws every new `keyframe` (`Keyframe` of `naraha.systems.slam`) in Meshcat: its points, thinned and coloured by
    height, are added below `map/`, and the newest scan is drawn in white below `scan/` until the next one replaces it.
    Objects appear at their time in a Meshcat recording. Drawing is all that it does: the only state is the index of
    the keyframe that was drawn last.
    """

    def __init__(self, config: KeyframeDisplayConfig, meshcat: Meshcat):
        super().__init__()
        check_config(config, key="display")
        self._config = config
        self._meshcat = meshcat
        self.DeclareAbstractInputPort("keyframe", AbstractValue.Make(object()))
        self._drawn = int(self.DeclareDiscreteState(np.array([-1.0])))
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, 0.0, self._Draw)

    def _Draw(self, context: Context, discrete_state: DiscreteValues) -> None:
        keyframe = eval_typed(self, context, "keyframe", Keyframe)
        drawn = int(context.get_discrete_state(self._drawn)[0])
        if keyframe.index == drawn or len(keyframe.p_BP) == 0:
            return
        p_MP = points_in_map(keyframe)
        p_MP = p_MP[p_MP[:, 2] < self._config.max_height]
        if len(p_MP) > 0:
            time, size = context.get_time(), self._config.point_size
            thin = p_MP[:: -(-len(p_MP) // self._config.points_per_keyframe)]
            cloud = drake_cloud(thin, height_colours(thin[:, 2]))
            show_from(self._meshcat, f"map/{keyframe.index:05}", cloud, size=size, time=time)
            show_newest_scan(self._meshcat, keyframe, thin, size=size, time=time, before=drawn)
        discrete_state.set_value(self._drawn, np.array([float(keyframe.index)]))
