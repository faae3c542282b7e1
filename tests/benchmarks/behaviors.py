"""Random cluttered rooms for the coordinated behaviours (S4-g): does the robot arrive, and touch nothing?

    python -m tests.benchmarks.behaviors [--rooms 100] [--first-seed 0] [--json FILE]

Rooms are those of `tests.behaviors.cluttered_room`: 10 x 8 m with up to 14 turned boxes and columns, all at least 0.9 m
apart, for a robot of 0.5 m that moves exactly as commanded. It knows no map and plans nothing.
"""

import argparse
import time

import numpy as np
from naraha.systems.behaviors import read_behaviors

from tests.behaviors.cluttered_room import BEHAVIORS, Robot, random_room

from .report import print_table, use_one_core, write_json


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", type=int, default=100)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--json", metavar="FILE", help="where to write the numbers")
    arguments = parser.parse_args()
    use_one_core()
    robot = Robot(read_behaviors(BEHAVIORS))
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.rooms)
    start = time.perf_counter()
    drives = {seed: robot.drive(random_room(seed), seed=seed) for seed in seeds}
    wall = time.perf_counter() - start
    arrived = [drive for drive in drives.values() if drive.arrived]
    results: dict[str, object] = {
        "rooms": len(drives),
        "obstacles_mean": float(np.mean([len(random_room(seed).polygons) for seed in seeds])),
        "naraha_arrived": len(arrived),
        "naraha_collisions": sum(drive.clearance < 0 for drive in drives.values()),
        "naraha_min_clearance_m": min(drive.clearance for drive in drives.values()),
        "naraha_median_time_s": float(np.median([drive.time for drive in arrived])) if arrived else float("nan"),
        "wall_time_s": wall,
    }
    print_table("cluttered rooms", ("", "value"), list(results.items()))
    for seed, drive in drives.items():
        if not drive.arrived or drive.clearance < 0:
            print(f"room {seed}: arrived {drive.arrived}, clearance {drive.clearance:.3f} m")
    write_json(arguments.json, results)


if __name__ == "__main__":
    main()
