"""Routes in Meshcat: ribbons on the ground in colours that differ in lightness too, with labels to choose by."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from ..config import check_config, quantity
from ..ports import eval_typed
from ..routes import Route
from .map_display import screen_rgba
from .stroke_text import stroke_text

# Okabe and Ito's colours, which also those tell apart who see red and green alike; in the order of the routes.
ROUTE_COLOURS = ((0, 158, 115), (230, 159, 0), (86, 180, 233), (204, 121, 167), (240, 228, 66), (213, 94, 0))
_ROOT = "routes"


@dataclass(kw_only=True)
class RouteDisplayConfig:
    """How routes are drawn."""

    # [s] Period at which new routes are looked for.
    period: float = quantity(0.5, unit="s", above=0)
    # [m] Width of the ribbons; the chosen one is twice as wide.
    width: float = quantity(0.06, unit="m", above=0)
    # [m] Height over the ground.
    lift: float = quantity(0.06, unit="m", low=0)
    # [m] Height of the digits of a label.
    text_height: float = quantity(0.25, unit="m", above=0)


def route_title(number: int, route: Route) -> str:
    """What the label on the ground says: number from 1, length and time."""
    return f"{number + 1}: {route.length_m:.1f}m {route.time_s:.0f}s"


def draw_routes(
    meshcat: Meshcat,
    routes: Sequence[Route],
    *,
    chosen: int = -1,
    config: RouteDisplayConfig | None = None,
    path: str = _ROOT,
) -> None:
    """Draws routes at `<path>/1`, `<path>/2` and so on, in place of those that were there.

    Args:
        chosen: index of the route that is drawn wide, the others pale; -1: none is chosen yet.
    """
    config = config or RouteDisplayConfig()
    meshcat.Delete(path)
    for number, route in enumerate(routes):
        colour = ROUTE_COLOURS[number % len(ROUTE_COLOURS)]
        width = config.width * (2.0 if number == chosen else 1.0)
        rgba = screen_rgba(colour, 1.0 if chosen in (-1, number) else 0.35)
        z = _heights(route) + config.lift
        vertices, faces = _ribbon(route.xy, z, width)
        meshcat.SetTriangleMesh(f"{path}/{number + 1}/way", vertices.T, faces.T, rgba)
        flat, triangles = stroke_text(route_title(number, route), config.text_height)
        # Labels side by side would lie on each other where routes run together: each has its own share of the way.
        at = int(len(route.xy) * (number + 1) / (len(routes) + 1))
        corner = np.array([*(route.xy[at] + 0.15), z[at] + config.lift])
        placed = np.column_stack([flat, np.zeros(len(flat))]) + corner
        meshcat.SetTriangleMesh(f"{path}/{number + 1}/label", placed.T, triangles.T, rgba)


class RouteDisplay(LeafSystem):
    """
    .. pydrake_system::

        name: RouteDisplay
        input_ports:
        - routes
        - chosen

    Draws the `routes` (tuple of `Route`) that are offered in Meshcat below `routes/`, coloured and labelled with
    number, length and time (row S0-i: the operator sees the ways and picks one). `chosen` (1) is the index of the one
    that is driven, -1 as long as there is none; it is drawn wide and the others pale. Routes are drawn when they or
    the choice change. Drawing is all that it does: the only state is what was drawn last.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PortError: an input is not connected or of another type.
    """

    def __init__(self, config: RouteDisplayConfig | None = None, *, meshcat: Meshcat):
        super().__init__()
        self._config, self._meshcat = config or RouteDisplayConfig(), meshcat
        check_config(self._config, key="route_display")
        self.DeclareAbstractInputPort("routes", AbstractValue.Make(object()))
        self.DeclareVectorInputPort("chosen", 1)
        self.DeclareAbstractState(AbstractValue.Make(((), -1)))
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._config.period, 0.0, self._Draw)

    def _Draw(self, context: Context, state: State) -> EventStatus:
        routes = eval_typed(self, context, "routes", tuple)
        chosen = int(eval_typed(self, context, "chosen", np.ndarray)[0])
        held: Any = context.get_abstract_state(0)
        shown = (tuple(route.xy.tobytes() for route in routes), chosen)
        if shown == held.get_value():
            return EventStatus.DidNothing()
        draw_routes(self._meshcat, routes, chosen=chosen, config=self._config)
        state.get_mutable_abstract_state(0).set_value(shown)
        return EventStatus.Succeeded()


def _heights(route: Route) -> np.ndarray:
    """Heights of the points, unknown ones between known ones; 0 without any [m]."""
    known = np.isfinite(route.z)
    if not known.any():
        return np.zeros(len(route.z))
    return np.asarray(np.interp(route.arc_length, route.arc_length[known], route.z[known]))


def _ribbon(xy: np.ndarray, z: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray]:
    """A band along points (K, 2) at heights (K,): vertices (2 K, 3) and triangles (2 K − 2, 3)."""
    ahead = np.gradient(xy, axis=0)
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
    side = 0.5 * width * np.column_stack([-ahead[:, 1], ahead[:, 0]])
    vertices = np.column_stack([np.stack([xy - side, xy + side], axis=1).reshape(-1, 2), np.repeat(z, 2)])
    first = 2 * np.arange(len(xy) - 1)[:, None, None]
    return vertices, (first + np.array([[0, 2, 1], [1, 2, 3]])).reshape(-1, 3).astype(np.int32)
