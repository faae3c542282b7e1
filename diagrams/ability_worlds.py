"""Grounds on which robots are tried: a ramp, a slope along their side, a step, ridges, a stair, at any level."""

from collections.abc import Callable
from typing import Any

import numpy as np
from naraha.models.worlds import Solid, World
from naraha.models.worlds.ramps import wedge
from naraha.models.worlds.stair_hall import RUN
from naraha.models.worlds.surfaces import CONCRETE_FLOOR

# [m] Flat ground in front of the obstacle, which begins at x = 0, and the ground behind its edge.
RUN_UP, LENGTH, WIDTH = 4.0, 5.0, 6.0
# [m] Shortest and longest ramp of a ridge. Steps of a stair.
_RUNS = (0.3, 0.6)
_STEPS = 14


def ramp(slope: float, seed: int, friction: float) -> World:
    """A ramp that rises by `slope` [rad] along x."""
    thickness = 0.2
    middle = 0.5 * LENGTH * np.array([np.cos(slope), np.sin(slope)])
    middle += 0.5 * thickness * np.array([np.sin(slope), -np.cos(slope)])
    solid = _box("ramp", [LENGTH, WIDTH, thickness], [middle[0], 0.0, middle[1]], [0, -np.rad2deg(slope), 0], friction)
    return _world(friction, solid)


def side_slope(slope: float, seed: int, friction: float) -> World:
    """A plane through the x axis that rises to the left by `slope` [rad]."""
    z = -0.1 * np.cos(slope)
    length = RUN_UP + LENGTH
    middle = [0.5 * (LENGTH - RUN_UP), 0.1 * np.sin(slope), z]
    return _finish([_box("floor", [length, WIDTH, 0.2], middle, [np.rad2deg(slope), 0, 0], friction)])


def step(height: float, seed: int, friction: float) -> World:
    """A step up by `height` [m] at x = 0."""
    return _world(friction, _box("step", [LENGTH, WIDTH, height], [0.5 * LENGTH, 0, 0.5 * height], [0, 0, 0], friction))


def ridges(height: float, seed: int, friction: float) -> World:
    """Ridges across the way, `height` [m] at their crests, one after the other from x = 0 on, without upright faces.

    Their runs are drawn between 0.3 and 0.6 m: about as long as the robots are.
    """
    rng = np.random.default_rng(seed)
    solids, x, i = [], 0.0, 0
    while x < LENGTH - 2 * _RUNS[1]:
        run = float(rng.uniform(*_RUNS))
        slope = float(np.arctan2(height, run))
        for foot, yaw in ((x, 0.0), (x + 2 * run, np.pi)):
            look: dict[str, Any] = {"surface": "floor", "friction": friction}
            size: dict[str, float] = {"run": run, "width": WIDTH, "slope_deg": float(np.rad2deg(slope))}
            solids.append(wedge(f"ridge_{i}", (foot, 0.0), yaw=yaw, **size, **look))
            i += 1
        x += 2 * run
    return _world(friction, *solids)


def stair(rise: float, seed: int, friction: float) -> World:
    """A flight of steps up along x, each `rise` [m] high and as deep as in the stair hall; the first is at x = 0."""
    treads = []
    for i in range(_STEPS):
        size, top = [RUN, WIDTH, rise], (i + 1) * rise
        treads.append(_box(f"tread_{i}", size, [(i + 0.5) * RUN, 0, top - 0.5 * rise], [0, 0, 0], friction))
    return _world(friction, *treads)


GROUNDS: dict[str, Callable[[float, int, float], World]] = {
    "pitch_slope": ramp,
    "roll_slope": side_slope,
    "step": step,
    "ridges": ridges,
    "stair": stair,
}


def _box(name: str, size: list[float], xyz: list[float], rpy_deg: list[float], friction: float) -> Solid:
    return Solid(
        name=name,
        box=[float(v) for v in size],
        xyz=[float(v) for v in xyz],
        rpy_deg=[float(v) for v in rpy_deg],
        surface="floor",
        rgb=[0.55, 0.54, 0.5],
        friction=friction,
    )


def _world(friction: float, *solids: Solid) -> World:
    # The floor goes on below everything: a robot that misses the obstacle does not fall for ever.
    floor = _box("floor", [2 * (RUN_UP + LENGTH), 2 * WIDTH, 0.2], [0, 0, -0.1], [0, 0, 0], friction)
    return _finish([floor, *solids])


def _finish(solids: list[Solid]) -> World:
    return World(solids=solids, surfaces={"floor": CONCRETE_FLOOR})
