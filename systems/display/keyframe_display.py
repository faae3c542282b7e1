"""Keyframes in Meshcat: the map grows as the robot drives, also in a recording."""

from dataclasses import dataclass

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import Meshcat
from pydrake.perception import BaseField, Fields
from pydrake.perception import PointCloud as DrakePointCloud
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from ..config import check_config, quantity
from ..ports import eval_typed
from ..slam import Keyframe


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


def height_colours(z: np.ndarray) -> np.ndarray:
    """Colours from blue at the floor over green to red at 2 m. z: (N,) [m]; returns (3, N) uint8."""
    t = np.clip(z / 2.0, 0.0, 1.0)
    rgb = np.stack([np.clip(2 * t - 0.6, 0.1, 1), 0.35 + 0.5 * np.sin(np.pi * t), np.clip(1 - 1.6 * t, 0.1, 1)])
    return (255 * rgb).astype(np.uint8)


def drake_cloud(points: np.ndarray, colours: np.ndarray) -> DrakePointCloud:
    """A Drake cloud for Meshcat. points: (N, 3) [m]; colours: (3, N) uint8."""
    cloud = DrakePointCloud(len(points), Fields(BaseField.kXYZs | BaseField.kRGBs))
    cloud.mutable_xyzs()[:] = points.T
    cloud.mutable_rgbs()[:] = colours
    return cloud


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
        R_MB, p_MB = keyframe.X_MB.rotation().matrix(), keyframe.X_MB.translation()
        p_MP = keyframe.p_BP @ R_MB.T + p_MB
        p_MP = p_MP[p_MP[:, 2] < self._config.max_height]
        if len(p_MP) > 0:
            time = context.get_time()
            thin = p_MP[:: -(-len(p_MP) // self._config.points_per_keyframe)]
            self._show(f"map/{keyframe.index:05}", thin, height_colours(thin[:, 2]), self._config.point_size, time)
            white = np.full((3, len(thin)), 255, np.uint8)
            self._show(f"scan/{keyframe.index:05}", thin, white, 1.5 * self._config.point_size, time)
            if drawn >= 0:
                self._meshcat.SetProperty(f"scan/{drawn:05}", "visible", False, time)
        discrete_state.set_value(self._drawn, np.array([float(keyframe.index)]))

    def _show(self, path: str, points: np.ndarray, colours: np.ndarray, size: float, time: float) -> None:
        self._meshcat.SetObject(path, drake_cloud(points, colours), point_size=size)
        self._meshcat.SetProperty(path, "visible", False, 0.0)
        self._meshcat.SetProperty(path, "visible", True, time)
