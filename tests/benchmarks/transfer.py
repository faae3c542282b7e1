"""Routes learnt on a map and driven in the world that it is of: by SLAM, and by odometry as the paper did (row S0-i).

    python -m tests.benchmarks.transfer [--yards 40] [--first-seed 0] [--out out/transfer] [--json FILE]

In each yard of boxes and pillars the crawler drives 2.5 m and maps what its LiDAR sees by SLAM; a goal is drawn among
the far places of that map; the route to it is learnt on the map until it is certified, smoothed, and driven with
`PathFollower` and `KanayamaTracking` on the pose that SLAM gives. Beside it the same route from the same place by
odometry of encoders and IMU, and of encoders alone, which is what the paper's robot had. A drive has arrived when the
robot is truly within 0.2 m of the goal and has touched nothing. Yards where the map shows no place far enough are left
out and counted. Every yard leaves a line in `OUT/yards.jsonl`; those that are there are not driven again.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from .report import print_table, use_one_core, write_json
from .transfer_drive import POSES, try_yard

# [m] From the goal, by the truth.
_NEAR = 0.2


def summary(yards: list[dict[str, Any]]) -> dict[str, object]:
    """Shares and distances of the yards that were driven in."""
    driven = [yard for yard in yards if yard["status"] == "driven"]
    results: dict[str, object] = {
        "yards": len(driven),
        "yards_without_goal": len(yards) - len(driven),
        "way_median_m": float(np.median([yard["way_m"] for yard in driven])),
        "way_max_m": max(yard["way_m"] for yard in driven),
        "cpu_median_s": float(np.median([yard["cpu_s"] for yard in driven])),
        "cpu_max_s": max(yard["cpu_s"] for yard in driven),
        "map_and_learning_median_s": float(np.median([yard["map_and_learning_s"] for yard in driven])),
        "gap_max": max(yard["gap"] for yard in driven),
    }
    for pose in POSES:
        errors = np.array([yard[f"{pose}_error"] for yard in driven])
        touched = np.array([yard[f"{pose}_touched"] for yard in driven]) > 0
        results |= {
            f"{pose}_arrived": int(((errors <= _NEAR) & ~touched).sum()),
            f"{pose}_arrived_share": float(((errors <= _NEAR) & ~touched).mean()),
            f"{pose}_touched": int(touched.sum()),
            f"{pose}_error_median_m": float(np.median(errors)),
            f"{pose}_error_max_m": float(errors.max()),
        }
    return results


def read_yards(path: Path) -> dict[int, dict[str, Any]]:
    """What was driven already, by seed."""
    lines = path.read_text().splitlines() if path.is_file() else []
    return {yard["seed"]: yard for yard in map(json.loads, lines)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--yards", type=int, default=40, help="in which a route is driven")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("out/transfer"))
    parser.add_argument("--json", metavar="FILE", help="where to write the numbers")
    arguments = parser.parse_args()
    use_one_core()
    arguments.out.mkdir(parents=True, exist_ok=True)
    record = arguments.out / "yards.jsonl"
    known, yards, seed = read_yards(record), [], arguments.first_seed
    while sum(yard["status"] == "driven" for yard in yards) < arguments.yards:
        if seed not in known:
            known[seed] = try_yard(seed)
            with record.open("a") as file:
                file.write(json.dumps(known[seed]) + "\n")
        yards.append(known[seed])
        seed += 1
    results = summary(yards)
    print_table("transfer", ("value", "measured"), list(results.items()))
    for yard in yards:
        for pose in POSES if yard["status"] == "driven" else ():
            error, touched = yard[f"{pose}_error"], yard[f"{pose}_touched"]
            if error > _NEAR or touched:
                print(f"yard {yard['seed']} by {pose}: {error:.2f} m off, touched {touched}")
    write_json(arguments.json, results)


if __name__ == "__main__":
    main()
