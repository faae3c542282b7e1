"""Random rough ground with a way through it that a stated robot can drive, or with none.

A yard of 11 × 8 m. From the start to the goal runs a bent corridor, and what stands in it keeps to the limits that the
caller states: low blocks, ridges and a hill. Anything else may stand anywhere else: pillars, walls, rubble, steep
ramps, platforms and the gaps between them.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from .ramps import SURFACES, pillar, ridge, walled_floor, wedge
from .stair_hall import clearance
from .world import Solid, World

# Inner faces of the walls: lowest and highest x, lowest and highest y [m].
BOUNDS = (-5.5, 5.5, -4.0, 4.0)
# Flat within this distance of the start and of the goal [m].
FLAT = 1.0
_START_X, _GOAL_X, _SIDE = -4.2, 4.2, 2.4
# Crest of the highest steep ramp, and of the walls: more than 1 m above anything else [m].
_HIGHEST, _BARRIER = 0.45, 2.7
_RUBBLE: dict[str, Any] = {"surface": "debris", "rgb": [0.45, 0.43, 0.42]}
_WALL: dict[str, Any] = {"surface": "wall", "rgb": [0.72, 0.71, 0.68]}


@dataclass(frozen=True, eq=False)
class RoughField:
    """A yard and where to drive in it.

    Attributes:
        start_xy, start_yaw: of the robot, in W [m], [rad].
        goal_xy: in W [m].
        path: (K, 2) middle of the corridor from start to goal [m]. With `blocked`, a wall is across it.
        width: of the corridor [m].
    """

    world: World
    start_xy: np.ndarray
    start_yaw: float
    goal_xy: np.ndarray
    path: np.ndarray
    width: float


def build(
    seed: int = 0,
    *,
    severity: float = 0.5,
    blocked: bool = False,
    width: float = 1.5,
    max_slope_deg: float = 7.0,
    max_step: float = 0.015,
    max_roughness: float = 1e-4,
) -> RoughField:
    """Draws a yard from `seed`.

    The defaults are for a robot that manages next to nothing, so that whatever robot there is can reach the goal.

    Args:
        severity: from 0, an empty yard, to 1, as much as it holds.
        blocked: whether a wall, around the goal or right across the yard, keeps every robot from the goal. Everything
            else is as without it.
        width: of the corridor [m].
        max_slope_deg: steepest ramp in the corridor [deg].
        max_step: highest step in the corridor, up or down [m].
        max_roughness: largest variance of heights about a plane that a block or ridge in the corridor makes [m²].
    """
    rng = np.random.default_rng([seed, 2827])
    path = _draw_path(rng)
    start, goal = path[0], path[-1]
    ahead = goal - start
    yaw = float(np.arctan2(ahead[1], ahead[0]) + rng.uniform(-0.7, 0.7))
    severity = float(np.clip(severity, 0, 1))
    hard = _obstacles(rng, path, severity, width)
    easy = _corridor(rng, path, severity, width, max_slope_deg, max_step, max_roughness)
    barrier = _barrier(rng, goal) if blocked else []
    world = World(solids=[*walled_floor(BOUNDS, height=_BARRIER), *hard, *easy, *barrier], surfaces=SURFACES)
    return RoughField(world, start, yaw, goal, path, width)


def _draw_path(rng: np.random.Generator) -> np.ndarray:
    """A polyline (4, 2) [m] from one side of the yard to the other, with two bends."""
    sides = rng.uniform(-_SIDE, _SIDE, 4)
    across = [_START_X, rng.uniform(-1.9, -1.1), rng.uniform(1.1, 1.9), _GOAL_X]
    return np.column_stack([across, sides])


def _obstacles(rng: np.random.Generator, path: np.ndarray, severity: float, width: float) -> list[Solid]:
    """What no robot is asked to drive over, clear of the corridor and of the ends of the path."""
    solids: list[Solid] = []
    makers = (_pillar, _wall, _rubble, _platforms, _steep_ramp)
    for i in range(round(36 * severity)):
        make = makers[int(rng.choice(len(makers), p=[0.2, 0.2, 0.25, 0.2, 0.15]))]
        for _ in range(8):
            if rng.random() < 0.4:  # in the straight way, which would be free too often otherwise
                place = path[0] + rng.uniform(0.2, 0.8) * (path[-1] - path[0]) + rng.normal(0, 0.4, 2)
            else:
                place = rng.uniform([BOUNDS[0] + 0.2, BOUNDS[2] + 0.2], [BOUNDS[1] - 0.2, BOUNDS[3] - 0.2])
            parts = make(rng, f"{make.__name__[1:]}_{i + 1}", place)
            if all(_clear(part, path, width) for part in parts):
                solids += parts
                break
    return solids


def _clear(solid: Solid, path: np.ndarray, width: float) -> bool:
    """Whether a solid leaves the corridor free, seen from above, and does not stick out of the walls."""
    if solid.cylinder:
        edge = np.array([solid.xyz[:2]])
        reach = solid.cylinder[0]
    else:
        # Along the edges of the box: twelve, as seen from above.
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * np.array(solid.box) / 2
        seen = (solid.X_WG() @ corners.T).T[:, :2]
        share = np.linspace(0, 1, 13)[:, None, None]
        edge = (seen[None, :, None] * share[..., None] + seen[None, None] * (1 - share[..., None])).reshape(-1, 2)
        reach = 0.0
    ends = np.linalg.norm(edge[:, None] - path[[0, -1]], axis=2).min() - reach
    west, east, south, north = BOUNDS
    inside = (edge > [west - 0.1, south - 0.1]).all() and (edge < [east + 0.1, north + 0.1]).all()
    return bool(inside and clearance(edge, path).min() - reach > width / 2 and ends > FLAT)


def _pillar(rng: np.random.Generator, name: str, place: np.ndarray) -> list[Solid]:
    return [pillar(name, place.tolist(), float(rng.uniform(0.06, 0.25)), float(rng.uniform(0.5, 1.6)))]


def _wall(rng: np.random.Generator, name: str, place: np.ndarray) -> list[Solid]:
    size = [float(rng.uniform(0.8, 2.4)), 0.15, float(rng.uniform(0.5, 1.4))]
    return [_box(name, size, place, rng.uniform(0, 180), **_WALL)]


def _rubble(rng: np.random.Generator, name: str, place: np.ndarray) -> list[Solid]:
    """A heap of blocks at all angles; as high as a third of a metre."""
    parts = []
    for i in range(1, int(rng.integers(4, 9)) + 1):
        xyz = [*(place + rng.normal(0, 0.25, 2)).tolist(), float(rng.uniform(0.0, 0.12))]
        size, tilt = rng.uniform([0.15, 0.1, 0.05], [0.5, 0.35, 0.2]).tolist(), rng.uniform(-35, 35, 3) * [1, 1, 5]
        parts.append(Solid(name=f"{name}_{i}", box=size, xyz=xyz, rpy_deg=tilt.tolist(), **_RUBBLE))
    return parts


def _platforms(rng: np.random.Generator, name: str, place: np.ndarray) -> list[Solid]:
    """A platform, or two with a gap between them that is as deep as they are high."""
    height, angle = float(rng.uniform(0.1, 0.4)), float(rng.uniform(0, 180))
    size = [float(rng.uniform(0.6, 1.3)), float(rng.uniform(0.6, 1.3)), height]
    parts = [_box(f"{name}_1", size, place, angle, surface="debris", rgb=[0.55, 0.52, 0.5])]
    if rng.random() < 0.5:
        ahead = np.array([np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))])
        other = place + (size[0] + rng.uniform(0.25, 0.5)) * ahead
        parts.append(_box(f"{name}_2", size, other, angle, surface="debris", rgb=[0.55, 0.52, 0.5]))
    return parts


def _steep_ramp(rng: np.random.Generator, name: str, place: np.ndarray) -> list[Solid]:
    run, slope = float(rng.uniform(0.5, 0.9)), float(rng.uniform(18, 45))
    run = min(run, _HIGHEST / np.tan(np.deg2rad(slope)))
    foot, yaw = (float(place[0]), float(place[1])), float(rng.uniform(0, 2 * np.pi))
    return ridge(name, foot, yaw=yaw, run=float(run), width=float(rng.uniform(0.6, 1.2)), slope_deg=slope)


def _corridor(
    rng: np.random.Generator,
    path: np.ndarray,
    severity: float,
    width: float,
    max_slope_deg: float,
    max_step: float,
    max_roughness: float,
) -> list[Solid]:
    """What stands in the corridor: on every leg a hill, a ridge across it, blocks, or nothing."""
    solids: list[Solid] = []
    for i, (first, last) in enumerate(pairwise(path), 1):
        if rng.random() > 0.4 + 0.6 * severity:
            continue
        length = float(np.linalg.norm(last - first))
        ahead = (last - first) / length
        yaw, slope = float(np.arctan2(ahead[1], ahead[0])), float(max_slope_deg * rng.uniform(0.6, 1.0))
        # From the bends and the flat ends it keeps the length that a robot needs to turn.
        middle = first + ahead * rng.uniform(0.45, 0.55) * length
        room = 0.45 * length - (FLAT if i in (1, len(path) - 1) else 0.5)
        across = width + 0.6
        kind = rng.choice(["hill", "ridge", "blocks"])
        if kind == "hill" and room > 0.7:
            solids += _hill(f"hill_{i}", middle, yaw, room, across, slope)
        elif kind == "ridge" and room > 0.3:
            # Heights of a ridge are spread evenly, with a variance of height²/12.
            rise = min(np.sqrt(12 * max_roughness), room * np.tan(np.deg2rad(slope)))
            run = float(rise / np.tan(np.deg2rad(slope)))
            at = (float(middle[0]), float(middle[1]))
            solids += ridge(f"ridge_{i}", at, yaw=yaw, run=run, width=across, slope_deg=slope)
        else:
            # A block under part of a plane makes at most height²/4.
            highest = min(max_step, 2 * np.sqrt(max_roughness))
            solids += _blocks(rng, f"block_{i}", first, last, room, width, highest, round(2 + 6 * severity))
    return solids


def _hill(name: str, middle: np.ndarray, yaw: float, room: float, width: float, slope_deg: float) -> list[Solid]:
    """Up, level and down; beside it the ground drops by its height. `room`: half its length along the way [m]."""
    ahead = np.array([np.cos(yaw), np.sin(yaw)])
    run, top = room - 0.3, 0.6
    size: dict[str, Any] = {"run": run, "width": width, "slope_deg": slope_deg}
    near, far = middle - room * ahead, middle + room * ahead
    height = float(run * np.tan(np.deg2rad(slope_deg)))
    return [
        wedge(f"{name}_up", (float(near[0]), float(near[1])), yaw=yaw, **size),
        wedge(f"{name}_down", (float(far[0]), float(far[1])), yaw=yaw + np.pi, **size),
        _box(f"{name}_top", [top, width, height], middle, np.rad2deg(yaw), surface="ramp", rgb=[0.72, 0.6, 0.42]),
    ]


def _blocks(
    rng: np.random.Generator,
    name: str,
    first: np.ndarray,
    last: np.ndarray,
    room: float,
    width: float,
    highest: float,
    count: int,
) -> list[Solid]:
    """Low blocks that do not touch each other, so that no step is higher than one of them."""
    along = (last - first) / np.linalg.norm(last - first)
    sides = np.array([-along[1], along[0]])
    places: list[np.ndarray] = []
    solids = []
    for _ in range(count):
        place = (first + last) / 2 + rng.uniform(-room, room) * along + rng.uniform(-0.5, 0.5) * width * sides
        if all(np.linalg.norm(place - other) > 0.6 for other in places):
            places.append(place)
            size = [*rng.uniform(0.15, 0.4, 2).tolist(), float(rng.uniform(0.5, 1.0) * highest)]
            solids.append(_box(f"{name}_{len(places)}", size, place, rng.uniform(0, 90), **_RUBBLE))
    return solids


def _barrier(rng: np.random.Generator, goal: np.ndarray) -> list[Solid]:
    """Walls around the goal, or one right across the yard."""
    south, north = BOUNDS[2:]
    if rng.random() < 0.5:
        size, middle = [0.2, north - south, _BARRIER], np.array([rng.uniform(0.5, 2.5), 0.0])
        return [_box("barrier", size, middle, 0.0, **_WALL)]
    half, ring = 1.15, []
    for i, (x, y) in enumerate(((1, 0), (-1, 0), (0, 1), (0, -1)), 1):
        size = [0.2 if x else 2 * half + 0.2, 0.2 if y else 2 * half + 0.2, _BARRIER]
        ring.append(_box(f"barrier_{i}", size, goal + half * np.array([x, y]), 0.0, **_WALL))
    return ring


def _box(name: str, size: list[float], place: np.ndarray, yaw_deg: float, **look: Any) -> Solid:
    """A box that stands on the floor."""
    xyz = [float(place[0]), float(place[1]), size[2] / 2]
    return Solid(name=name, box=size, xyz=xyz, rpy_deg=[0.0, 0.0, float(yaw_deg)], **look)
