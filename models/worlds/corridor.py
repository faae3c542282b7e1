"""A bare corridor, 40 m long: no geometry tells how far along it one is, only puddles and reflective signs do."""

from typing import Any

import numpy as np

from . import surfaces
from .world import Solid, World

LENGTH, WIDTH, HEIGHT = 40.0, 2.4, 2.6


def build(seed: int = 0) -> World:
    """Builds the corridor along x from 0 to 40 m. `seed` places the puddles and the signs."""
    rng = np.random.default_rng(seed)
    middle = LENGTH / 2
    look: dict[str, Any] = {"surface": "wall", "rgb": [0.72, 0.71, 0.68]}
    solids = [
        Solid(name="floor", box=[LENGTH, WIDTH, 0.2], xyz=[middle, 0, -0.1], surface="floor", rgb=[0.5, 0.5, 0.48]),
        Solid(name="wall_left", box=[LENGTH, 0.2, HEIGHT], xyz=[middle, WIDTH / 2 + 0.1, HEIGHT / 2], **look),
        Solid(
            name="wall_right", alpha=0.25, box=[LENGTH, 0.2, HEIGHT], xyz=[middle, -WIDTH / 2 - 0.1, HEIGHT / 2], **look
        ),
        Solid(name="wall_near", box=[0.2, WIDTH + 0.4, HEIGHT], xyz=[-0.1, 0, HEIGHT / 2], **look),
        Solid(name="wall_far", box=[0.2, WIDTH + 0.4, HEIGHT], xyz=[LENGTH + 0.1, 0, HEIGHT / 2], **look),
    ]
    for i, x in enumerate(np.arange(3.0, LENGTH - 1, 2.5), 1):
        place = [float(x + rng.uniform(-0.8, 0.8)), float(rng.choice([-0.8, 0.8])), 0.0]
        water: dict[str, Any] = {"surface": "water", "rgb": [0.15, 0.35, 0.6], "collides": False}
        solids.append(Solid(name=f"puddle_{i}", cylinder=[rng.uniform(0.2, 0.35), 0.01], xyz=place, **water))
    for i, x in enumerate(np.arange(2.0, LENGTH, 3.0), 1):
        side = rng.choice([-1, 1])
        place = [float(x + rng.uniform(-1, 1)), float(side * (WIDTH / 2 - 0.005)), rng.uniform(0.5, 1.2)]
        sign: dict[str, Any] = {"surface": "sign", "rgb": [0.95, 0.85, 0.2]}
        solids.append(Solid(name=f"sign_{i}", box=[rng.uniform(0.2, 0.5), 0.01, 0.3], xyz=place, **sign))
    return World(
        solids=solids,
        surfaces={
            "floor": surfaces.CONCRETE_FLOOR,
            "wall": surfaces.CONCRETE_WALL,
            "water": surfaces.WATER,
            "sign": surfaces.SIGN,
        },
    )
