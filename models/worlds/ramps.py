"""Parts of worlds of ramps: wedges, ridges, lanes of them, walled floors, pillars, and what they are made of."""

from dataclasses import replace
from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw

from . import surfaces
from .world import Solid

# Slope, and length on the floor and width of a half ramp, after ASTM E2827 [deg, m].
SLOPE_DEG = 15.0
RUN, LANE = 0.6, 1.2
PLYWOOD = replace(surfaces.WOOD, label="ramp")
_WOOD_RGB, _WALL_RGB = [0.72, 0.6, 0.42], [0.72, 0.71, 0.68]
SURFACES = {
    "floor": surfaces.CONCRETE_FLOOR,
    "wall": surfaces.CONCRETE_WALL,
    "ramp": PLYWOOD,
    "debris": surfaces.RUBBLE,
}


def wedge(
    name: str,
    foot: tuple[float, float],
    *,
    yaw: float = 0.0,
    run: float = RUN,
    width: float = LANE,
    slope_deg: float = SLOPE_DEG,
    **look: Any,
) -> Solid:
    """A ramp as one tilted box, so thick that its lower side is in the floor all over.

    Its upper end leans out by as much as the slope is from upright: a neighbour as high, or a platform, hides it.

    Args:
        foot: x, y of the middle of the lower edge [m]. yaw: direction in which it rises [rad].
        run, width: lengths on the floor, along and across [m].
    """
    slope = np.deg2rad(slope_deg)
    length, thickness = run / np.cos(slope), run * np.tan(slope) / np.cos(slope) + 0.02
    tilt = RollPitchYaw(0.0, -slope, yaw)
    X_WF = RigidTransform(tilt, np.array([*foot, 0.0]))
    xyz = (X_WF @ np.array([length / 2, 0.0, -thickness / 2])).tolist()
    look = {"surface": "ramp", "rgb": _WOOD_RGB, **look}
    rpy = np.rad2deg(tilt.vector()).tolist()
    return Solid(name=name, box=[float(length), width, float(thickness)], xyz=xyz, rpy_deg=rpy, **look)


def ridge(
    name: str,
    middle: tuple[float, float],
    *,
    yaw: float = 0.0,
    run: float = RUN,
    width: float = LANE,
    slope_deg: float = SLOPE_DEG,
    **look: Any,
) -> list[Solid]:
    """Two ramps that rise towards each other, the crest across `yaw` [rad] at `middle`; see `wedge`."""
    reach = run * np.array([np.cos(yaw), np.sin(yaw)])
    near, far = (np.array(middle) + sign * reach for sign in (-1, 1))
    size: dict[str, Any] = {"run": run, "width": width, "slope_deg": slope_deg, **look}
    return [
        wedge(f"{name}_up", (float(near[0]), float(near[1])), yaw=yaw, **size),
        wedge(f"{name}_down", (float(far[0]), float(far[1])), yaw=yaw + np.pi, **size),
    ]


def ramp_lane(name: str, middle: tuple[float, float], ridges: int) -> list[Solid]:
    """A lane of half ramps along x, floor at either end."""
    crests = middle[0] + 2 * RUN * (np.arange(ridges) - (ridges - 1) / 2)
    return [
        solid
        for i, x in enumerate(crests.tolist(), 1)
        for solid in ridge(f"{name}_{i}", (x, middle[1]), rgb=[c + 0.06 * (i % 2) for c in _WOOD_RGB])
    ]


def walled_floor(bounds: tuple[float, float, float, float], height: float = 1.2) -> list[Solid]:
    """A floor at z = 0 between walls whose inner faces are at `bounds`: lowest and highest x, lowest and highest y."""
    west, east, south, north = bounds
    x, y, length, width = (west + east) / 2, (south + north) / 2, east - west, north - south
    wall: dict[str, Any] = {"surface": "wall", "rgb": _WALL_RGB, "alpha": 0.5}
    floor = [length + 0.4, width + 0.4, 0.2]
    return [
        Solid(name="floor", box=floor, xyz=[x, y, -0.1], surface="floor", rgb=[0.5, 0.5, 0.48]),
        Solid(name="wall_north", box=[length, 0.2, height], xyz=[x, north + 0.1, height / 2], **wall),
        Solid(name="wall_south", box=[length, 0.2, height], xyz=[x, south - 0.1, height / 2], **wall),
        Solid(name="wall_east", box=[0.2, width + 0.4, height], xyz=[east + 0.1, y, height / 2], **wall),
        Solid(name="wall_west", box=[0.2, width + 0.4, height], xyz=[west - 0.1, y, height / 2], **wall),
    ]


def pillar(name: str, xy: list[float], radius: float, height: float = 1.2) -> Solid:
    """An upright pillar on the floor [m]."""
    place = [xy[0], xy[1], height / 2]
    return Solid(name=name, cylinder=[radius, height], xyz=place, surface="wall", rgb=[0.85, 0.45, 0.2])
