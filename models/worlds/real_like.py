"""A field of ramps beside flat ground: what the paper's experiment with real robots looked like (row S3-f).

The paper gives no dimensions; they are ours. The straight way from the start to the goal leads over two ridges of the
field, see `e2827`; beside it is flat ground.
"""

import numpy as np

from .ramps import LANE, RUN, SURFACES, ramp_lane, walled_floor
from .world import World

# x, y [m] and heading [rad] at the start; x, y [m] of the goal.
START, GOAL = (-2.4, -0.6, 0.0), (2.4, -0.6)
HALF_LENGTH, NORTH = 2 * RUN, 1.2
WAY_AROUND = np.array([START[:2], [-HALF_LENGTH, 1.75], [HALF_LENGTH, 1.75], GOAL])


def build(seed: int = 0) -> World:
    """Builds the yard, walls 0.6 m high. `seed` moves the field along x by up to 5 cm."""
    x = float(np.random.default_rng(seed).uniform(-0.05, 0.05))
    # The lane of the straight way has two ridges, the one beside it has one in between.
    lanes = [*ramp_lane("lane_1", (x, NORTH - 1.5 * LANE), 2), *ramp_lane("lane_2", (x, NORTH - LANE / 2), 1)]
    return World(solids=[*walled_floor((-3.4, 3.4, -1.2, 3.0), height=0.6), *lanes], surfaces=SURFACES)
