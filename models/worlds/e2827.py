"""Crossing pitch/roll ramps in a room with two pillars: the paper's simulated experiment (rows S3-e, S3-f).

After ASTM E2827: ramps of 15° that are not continuous. Elements are half ramps, 0.6 m long and 1.2 m wide; the lanes
that they form rise and fall out of step, so that where two lanes meet there is an upright face of up to 0.16 m. How
the lanes are laid out, the room and the pillars are our own: the paper gives no dimensions. Where they stand, the
straight way leads over three ridges and the flat way around the field is half as long again and more.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw

from . import surfaces
from .world import Solid, World

SLOPE_DEG = 15.0
# Length on the floor and width of a half ramp [m].
RUN, LANE = 0.6, 1.2
# x, y [m] and heading [rad] at the start; x, y [m] of the goal.
START, GOAL = (-3.6, -0.2, 0.0), (3.8, 0.4)
# Half the length of the field, and its edges along y: the southern one is at the wall [m].
HALF_LENGTH, SOUTH, NORTH = 3 * RUN, -1.8, 3.0
# Flat way around, for the length of it and for tests: its middle [m].
WAY_AROUND = np.array([START[:2], [-2.2, 3.6], [2.2, 3.6], GOAL])
# The first stands between the two ways, the second on the straight one [m].
PILLARS, PILLAR_RADIUS = ((-2.5, 0.75), (2.75, 0.35)), 0.12
ROOM = (-4.8, 5.0, SOUTH, 4.3)

PLYWOOD = replace(surfaces.WOOD, label="ramp")
_WOOD_RGB, _WALL_RGB = [0.72, 0.6, 0.42], [0.72, 0.71, 0.68]


def build(seed: int = 0) -> World:
    """Builds the room. `seed` moves the pillars by up to 5 cm.

    Frame W: x from the start to the goal, the field around x = 0.
    """
    rng = np.random.default_rng(seed)
    # Every second lane has one ridge less and so begins half a period later.
    middles = np.arange(SOUTH + LANE / 2, NORTH, LANE)
    lanes = [
        solid
        for i, y in enumerate(middles, 1)
        for solid in ramp_lane(f"lane_{i}", (0.0, float(y)), 3 if i % 2 == 0 else 2)
    ]
    places = np.array(PILLARS) + rng.uniform(-0.05, 0.05, (2, 2))
    pillars = [pillar(f"pillar_{i}", xy, PILLAR_RADIUS) for i, xy in enumerate(places.tolist(), 1)]
    return World(solids=[*walled_floor(ROOM), *lanes, *pillars], surfaces=SURFACES)


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
