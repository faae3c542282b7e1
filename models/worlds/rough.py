"""Rough ground: a walled yard with low blocks and ramps drawn from a seed, all of them passable for the crawler."""

from typing import Any

import numpy as np

from . import surfaces
from .world import Solid, World

SIZE = 12.0


def build(seed: int = 0) -> World:
    """Builds a yard of 12 × 12 m around the origin; within 1 m of (-4.5, -4.5), where a robot starts, it is flat.

    Blocks are at most 0.08 m high and ramps at most 12° steep.
    """
    rng = np.random.default_rng(seed)
    wall: dict[str, Any] = {"surface": "wall", "rgb": [0.72, 0.71, 0.68]}
    half = SIZE / 2
    solids = [
        Solid(name="floor", box=[SIZE, SIZE, 0.2], xyz=[0, 0, -0.1], surface="floor", rgb=[0.5, 0.5, 0.48]),
        Solid(name="wall_north", box=[SIZE, 0.2, 2.0], xyz=[0, half + 0.1, 1.0], **wall),
        Solid(name="wall_south", box=[SIZE, 0.2, 2.0], xyz=[0, -half - 0.1, 1.0], **wall),
        Solid(name="wall_east", box=[0.2, SIZE + 0.4, 2.0], xyz=[half + 0.1, 0, 1.0], **wall),
        Solid(name="wall_west", box=[0.2, SIZE + 0.4, 2.0], xyz=[-half - 0.1, 0, 1.0], **wall),
    ]
    start = np.array([-4.5, -4.5])

    def place() -> np.ndarray:
        while True:
            xy = rng.uniform(-5.2, 5.2, 2)
            if np.linalg.norm(xy - start) > 1.0 + 0.7:
                return xy

    for i in range(1, 61):
        (x, y), height = place(), rng.uniform(0.02, 0.08)
        size = [*rng.uniform(0.15, 0.6, 2).tolist(), float(height)]
        yaw = [0.0, 0.0, float(rng.uniform(0, 90))]
        rubble: dict[str, Any] = {"surface": "debris", "rgb": [0.45, 0.43, 0.42]}
        solids.append(Solid(name=f"block_{i}", box=size, xyz=[x, y, height / 2], rpy_deg=yaw, **rubble))
    for i in range(1, 9):
        (x, y), slope = place(), float(rng.uniform(5, 12))
        # A long thin box, tilted; its lower edge is in the floor.
        length, thickness = 1.2, 0.1
        z = np.sin(np.deg2rad(slope)) * length / 2 - np.cos(np.deg2rad(slope)) * thickness / 2
        ramp: dict[str, Any] = {"surface": "ramp", "rgb": [0.6, 0.6, 0.55]}
        tilt = [0.0, -slope, float(rng.uniform(0, 360))]
        solids.append(Solid(name=f"ramp_{i}", box=[length, 0.9, thickness], xyz=[x, y, z], rpy_deg=tilt, **ramp))
    return World(
        solids=solids,
        surfaces={
            "floor": surfaces.CONCRETE_FLOOR,
            "wall": surfaces.CONCRETE_WALL,
            "debris": surfaces.RUBBLE,
            "ramp": surfaces.CONCRETE_FLOOR,
        },
    )
