"""What the fused map says, in Meshcat: a layer for each attribute, which grows as the robot drives."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from ..config import check_config, quantity
from ..ports import eval_typed
from ..slam.keyframe import NO_KEYFRAME, Keyframe
from .colours import HEIGHT, INTENSITY, NIR, TEMPERATURE, ColourScale, for_meshcat
from .keyframe_display import (
    KeyframeDisplayConfig,
    drake_cloud,
    hide_scan,
    points_in_map,
    show_from,
    show_newest_scan,
)

# Layers that grow with every keyframe, by the attribute that they show; the first one is shown from the start.
POINT_LAYERS: dict[str, ColourScale] = {
    "height": HEIGHT,
    "intensity": INTENSITY,
    "nir": NIR,
    "temperature": TEMPERATURE,
}


@dataclass(kw_only=True)
class SemanticDisplayConfig(KeyframeDisplayConfig):
    """How fused keyframes are drawn. `points_per_keyframe` counts for the layer `height`."""

    # At most this many points a keyframe are kept in every other layer, and of the newest scan; a recording grows by
    # 32 bytes a point.
    points_per_layer: int = quantity(1200, low=1)
    # Interval at which the newest keyframe is drawn again while it is still being painted [s].
    refresh: float = quantity(2.0, unit="s", above=0)


def layer_path(name: str) -> str:
    """Path in Meshcat of the layer `name`; its own visibility is free, that of what is below follows the recording."""
    return f"layers/{name}"


def values_of(cloud: PointCloud, attribute: str) -> np.ndarray | None:
    """The attribute as (N,) float64, NaN where unknown; None when the cloud does not have it."""
    if "positions" not in cloud.point or attribute not in cloud.point:
        return None
    values = cloud.point[attribute].numpy().astype(float)
    return values[:, 0] if values.ndim == 2 else values


def thin(kept: np.ndarray, most: int) -> np.ndarray:
    """Indices of evenly chosen entries of the mask `kept`, (N,) bool, at most `most` of them."""
    indices = np.flatnonzero(kept)
    return indices[:: max(1, -(-len(indices) // most))]


def draw_keyframe(meshcat: Meshcat, keyframe: Keyframe, config: SemanticDisplayConfig, time: float) -> None:
    """Draws, or draws again, a keyframe's points in every layer whose attribute they have, at `layers/<name>/<index>`.

    In a recording they appear at `time` [s]. The index has five digits. Points whose value is unknown, and those
    above `config.max_height`, are left out.
    """
    p_MP = points_in_map(keyframe)
    for name, scale in POINT_LAYERS.items():
        values = p_MP[:, 2] if name == "height" else values_of(keyframe.cloud_B, name)
        if values is None:
            continue
        most = config.points_per_keyframe if name == "height" else config.points_per_layer
        shown = thin((p_MP[:, 2] < config.max_height) & np.isfinite(values), most)
        if len(shown) > 0:
            cloud = drake_cloud(p_MP[shown], for_meshcat(scale.colours(values[shown])))
            show_from(meshcat, f"{layer_path(name)}/{keyframe.index:05}", cloud, size=config.point_size, time=time)


def draw_last_keyframe(meshcat: Meshcat, keyframe: Keyframe, config: SemanticDisplayConfig, time: float) -> None:
    """Ends the drawing of a run at `time` [s]: the last keyframe is complete, and no scan is the newest any more.

    The white points of the newest scan would otherwise hide its colours.
    """
    draw_keyframe(meshcat, keyframe, config, time)
    hide_scan(meshcat, keyframe.index, time)


@dataclass(frozen=True, eq=False)
class _Drawn:
    """Abstract state; read-only, so that Drake may share it: the newest version seen, the one drawn last, and when."""

    newest: Keyframe = NO_KEYFRAME
    drawn: Keyframe = NO_KEYFRAME
    time: float = 0.0

    def __deepcopy__(self, memo: dict) -> "_Drawn":
        return self


class SemanticDisplay(LeafSystem):
    """
    .. pydrake_system::

        name: SemanticDisplay
        input_ports:
        - keyframe

    Draws every new `keyframe` (`Keyframe` of `naraha.systems.slam`) in Meshcat, once for each of `POINT_LAYERS` that
    its cloud has as an attribute, see `draw_keyframe`; the newest scan is also drawn in white below `scan/` until the
    next one replaces it. Only the layer `height` is visible until somebody switches another one on, in Meshcat's
    controls at `drake/layers` or in the panel of a recording.

    A keyframe may come again with the same index and more attributes. It is drawn at once, drawn again every
    `config.refresh` seconds while it changes, and a last time when the next index comes. The last keyframe of a run
    has no next one: whoever ends the run draws it with `draw_last_keyframe`. Drawing is all that this system does: its
    state is only what it has drawn.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PortError: the input is not connected or of another type.
    """

    def __init__(self, config: SemanticDisplayConfig, meshcat: Meshcat):
        super().__init__()
        check_config(config, key="display")
        self._config = config
        self._meshcat = meshcat
        self.DeclareAbstractInputPort("keyframe", AbstractValue.Make(object()))
        self.DeclareAbstractState(AbstractValue.Make(_Drawn()))
        self.DeclarePeriodicUnrestrictedUpdateEvent(config.period, 0.0, self._Draw)
        for i, name in enumerate(POINT_LAYERS):
            meshcat.SetProperty(layer_path(name), "visible", i == 0)

    def _Draw(self, context: Context, state: State) -> EventStatus:
        keyframe = eval_typed(self, context, "keyframe", Keyframe)
        state_now: Any = context.get_abstract_state(0)
        held: _Drawn = state_now.get_value()
        time = context.get_time()
        if keyframe.index < 0:
            return EventStatus.DidNothing()
        if keyframe.index != held.newest.index:
            if held.newest is not held.drawn:
                draw_keyframe(self._meshcat, held.newest, self._config, time)
            draw_keyframe(self._meshcat, keyframe, self._config, time)
            self._draw_scan(keyframe, held.newest.index, time)
            held = _Drawn(keyframe, keyframe, time)
        elif keyframe is not held.drawn and time >= held.time + self._config.refresh:
            draw_keyframe(self._meshcat, keyframe, self._config, time)
            held = _Drawn(keyframe, keyframe, time)
        elif keyframe is not held.newest:
            held = _Drawn(keyframe, held.drawn, held.time)
        else:
            return EventStatus.DidNothing()
        state.get_mutable_abstract_state(0).set_value(held)
        return EventStatus.Succeeded()

    def _draw_scan(self, keyframe: Keyframe, before: int, time: float) -> None:
        p_MP = points_in_map(keyframe)
        p_MP = p_MP[thin(p_MP[:, 2] < self._config.max_height, self._config.points_per_layer)]
        show_newest_scan(self._meshcat, keyframe, p_MP, size=self._config.point_size, time=time, before=before)
