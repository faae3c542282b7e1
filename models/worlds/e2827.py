"""Crossing pitch/roll ramps in a room with two pillars: the paper's simulated experiment (rows S3-e, S3-f).

After ASTM E2827: ramps of 15° that are not continuous. Elements are half ramps, 0.6 m long and 1.2 m wide; the lanes
that they form rise and fall out of step, so that where two lanes meet there is an upright face of up to 0.16 m. How
the lanes are laid out, the room and the pillars are our own: the paper gives no dimensions. Where they stand, the
straight way leads over three ridges and the flat way around the field is half as long again and more.
"""

import numpy as np

from .ramps import LANE, RUN, SURFACES, pillar, ramp_lane, walled_floor
from .world import World

# x, y [m] and heading [rad] at the start; x, y [m] of the goal.
START, GOAL = (-3.6, -0.2, 0.0), (3.8, 0.4)
# Half the length of the field, and its edges along y: the southern one is at the wall [m].
HALF_LENGTH, SOUTH, NORTH = 3 * RUN, -1.8, 3.0
# Flat way around, for the length of it and for tests: its middle [m].
WAY_AROUND = np.array([START[:2], [-2.2, 3.6], [2.2, 3.6], GOAL])
# The first stands between the two ways, the second on the straight one [m].
PILLARS, PILLAR_RADIUS = ((-2.5, 0.75), (2.75, 0.35)), 0.12
ROOM = (-4.8, 5.0, SOUTH, 4.3)


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
