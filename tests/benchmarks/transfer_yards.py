"""Yards with boxes and pillars anywhere, drawn from a seed."""

from dataclasses import dataclass

import numpy as np
from naraha.models.worlds import Solid, World
from naraha.models.worlds.ramps import SURFACES, pillar, walled_floor

# Inner faces of the walls: lowest and highest x, lowest and highest y [m].
BOUNDS = (-4.5, 4.5, -3.5, 3.5)
# [m] What the robot looks around on: its start and the way ahead of it are clear of obstacles by as much.
CLEAR, LOOK = 0.75, 2.5


@dataclass(frozen=True, eq=False)
class Yard:
    """A yard, and where the robot stands in it: `start` (3,) x, y, heading in W [m, m, rad]."""

    world: World
    start: np.ndarray


def build(seed: int) -> Yard:
    """A yard of 9 × 7 m with 9 to 14 boxes and pillars; `LOOK` ahead of the start there is none."""
    rng = np.random.default_rng([seed, 1403])
    start = np.array([-3.6, rng.uniform(-2.4, 2.4), rng.uniform(-0.4, 0.4)])
    ahead = start[:2] + LOOK * np.array([np.cos(start[2]), np.sin(start[2])])
    solids, wanted = walled_floor(BOUNDS), int(rng.integers(9, 15))
    for i in range(wanted):
        for _ in range(20):
            place = rng.uniform([BOUNDS[0] + 0.2, BOUNDS[2] + 0.2], [BOUNDS[1] - 0.2, BOUNDS[3] - 0.2])
            if rng.random() < 0.4:
                radius = float(rng.uniform(0.08, 0.25))
                solid = pillar(f"pillar_{i}", place.tolist(), radius, float(rng.uniform(0.4, 1.2)))
            else:
                size = rng.uniform([0.3, 0.3, 0.3], [1.2, 0.8, 1.0]).tolist()
                radius = 0.5 * float(np.hypot(size[0], size[1]))
                xyz, yaw = [*place.tolist(), size[2] / 2], float(rng.uniform(0, 180))
                look = {"surface": "debris", "rgb": [0.55, 0.5, 0.45]}
                solid = Solid(name=f"box_{i}", box=size, xyz=xyz, rpy_deg=[0.0, 0.0, yaw], **look)
            share = np.clip((place - start[:2]) @ (ahead - start[:2]) / LOOK**2, 0, 1)
            if np.linalg.norm(start[:2] + share * (ahead - start[:2]) - place) > CLEAR + radius:
                solids.append(solid)
                break
    return Yard(World(solids=solids, surfaces=SURFACES), start)
