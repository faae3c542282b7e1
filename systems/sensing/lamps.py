"""Lamps and windows, and the illuminance that they give (row S4-g)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import FrameId
from pydrake.math import RigidTransform

from ..config import check_config, quantity
from ..errors import ConfigError
from .ray_scene import RayScene

# Nearer than this a lamp is no point [m].
MIN_DISTANCE = 0.05
# What a ray meets this short before a lamp or window is the lamp or window itself [m].
_OWN_SIZE = 0.02


@dataclass(kw_only=True)
class Lamp:
    """A lamp that is small against its distance."""

    # [m] where it is in W.
    xyz: list[float] = quantity([0.0, 0.0, 3.0], unit="m", min_length=3)
    # [cd] luminous intensity along `axis`.
    intensity: float = quantity(1000.0, unit="cd", low=0.0)
    # Where it points; need not be of unit length.
    axis: list[float] = quantity([0.0, 0.0, -1.0], unit="-", min_length=3)
    # n of the intensity's fall with the angle from the axis, cosⁿ: 0 shines everywhere alike, 1 is a glowing disc.
    exponent: float = quantity(1.0, unit="-", low=0.0)


@dataclass(kw_only=True)
class Window:
    """An upright rectangle that shines alike in all directions into the room, such as a window to an overcast sky."""

    # [m] its middle in W.
    xyz: list[float] = quantity([0.0, 0.0, 1.5], unit="m", min_length=3)
    # [deg] direction of its normal into the room, about z from x.
    yaw_deg: float = quantity(0.0, unit="deg")
    # [m] width and height.
    size: list[float] = quantity([2.0, 1.5], unit="m", above=0.0, min_length=2)
    # [cd/m²] luminance: some 2 000 for an overcast sky at noon.
    luminance: float = quantity(2000.0, unit="cd/m²", low=0.0)
    # [m] it is sampled by patches of at most this side.
    patch: float = quantity(0.4, unit="m", above=0.0)


@dataclass(frozen=True, eq=False)
class Emitters:
    """Small sources, E of them. Read-only.

    Attributes:
        p_WE: where they are, (E, 3) [m].
        axis_W: unit vectors along which they shine most, (E, 3).
        intensity: along the axis, (E,) [cd].
        exponent: n of the fall with the angle, cosⁿ, (E,).
    """

    p_WE: np.ndarray
    axis_W: np.ndarray
    intensity: np.ndarray
    exponent: np.ndarray

    def __deepcopy__(self, memo: dict) -> "Emitters":
        return self

    def __len__(self) -> int:
        return len(self.intensity)


def make_emitters(lamps: Sequence[Lamp], windows: Sequence[Window] = (), *, where: object = "lamps") -> Emitters:
    """The lamps, and the windows cut into patches of intensity L dA along their normal with exponent 1.

    Raises:
        ConfigError: there is neither lamp nor window, a value is out of range, or an axis has no direction.
    """
    if not lamps and not windows:
        raise ConfigError("no lamp and no window", where=where, key="lamps", value=[], valid="at least one")
    check_config({"lamps": list(lamps), "windows": list(windows)}, where=where)
    places, axes, intensities, exponents = [], [], [], []
    for i, lamp in enumerate(lamps):
        length = float(np.linalg.norm(lamp.axis))
        if length == 0 or len(lamp.axis) != 3 or len(lamp.xyz) != 3:
            valid = "xyz and axis of three numbers, axis not zero"
            raise ConfigError("no direction or place", where=where, key=f"lamps[{i}]", value=lamp.axis, valid=valid)
        places.append(lamp.xyz)
        axes.append(np.array(lamp.axis, float) / length)
        intensities.append(lamp.intensity)
        exponents.append(lamp.exponent)
    for i, window in enumerate(windows):
        if len(window.xyz) != 3 or len(window.size) != 2:
            raise ConfigError("wrong length", where=where, key=f"windows[{i}]", valid="xyz: 3 numbers, size: 2")
        yaw = np.deg2rad(window.yaw_deg)
        normal, along = np.array([np.cos(yaw), np.sin(yaw), 0.0]), np.array([-np.sin(yaw), np.cos(yaw), 0.0])
        width, height = window.size
        columns, rows = (int(np.ceil(side / window.patch)) for side in window.size)
        for s in (np.arange(columns) + 0.5) / columns - 0.5:
            for t in (np.arange(rows) + 0.5) / rows - 0.5:
                places.append(np.array(window.xyz) + s * width * along + [0, 0, t * height])
                axes.append(normal)
                intensities.append(window.luminance * width * height / (columns * rows))
                exponents.append(1.0)
    return Emitters(np.array(places, float), np.array(axes, float), np.array(intensities, float), np.array(exponents))


def illuminance(
    p_WP: np.ndarray,
    n_W: np.ndarray,
    emitters: Emitters,
    scene: RayScene | None = None,
    X_WF: Mapping[FrameId, RigidTransform] | None = None,
) -> np.ndarray:
    """Direct illuminance of small flat plates, (N,) [lux].

    Each emitter that is in sight gives I cosⁿγ cosθ / d²: the inverse square of the distance d, the cosine of the angle
    θ from the plate's normal, and the emitter's own fall with the angle γ from its axis. Light that walls and floor
    throw back is not in it.

    Args:
        p_WP: (N, 3) [m]. n_W: unit normals, (N, 3), or (3,) for all.
        scene: what is in the way; nothing when not given. X_WF: poses of its moving frames.
    """
    p_WP = np.asarray(p_WP, float).reshape(-1, 3)
    normals = np.broadcast_to(np.asarray(n_W, float), p_WP.shape)
    way = emitters.p_WE - p_WP[:, None]
    distance = np.maximum(np.linalg.norm(way, axis=2), MIN_DISTANCE)
    direction = way / distance[..., None]
    cos_plate = np.maximum(np.einsum("nek,nk->ne", direction, normals), 0.0)
    cos_axis = np.maximum(-np.einsum("nek,ek->ne", direction, emitters.axis_W), 0.0)
    shape = np.where(emitters.exponent > 0, cos_axis**emitters.exponent, 1.0)
    share = emitters.intensity * shape * cos_plate / distance**2
    if scene is not None:
        point, emitter = np.nonzero(share > 0)
        hits = scene.cast(p_WP[point], direction[point, emitter], X_WF)
        hidden = hits.distance < distance[point, emitter] - _OWN_SIZE
        share[point[hidden], emitter[hidden]] = 0.0
    total: np.ndarray = share.sum(axis=1)
    return total
