"""Random rough yards for every robot: does it reach the goal, unharmed, and say so where there is no way?

    python -m tests.benchmarks.traverse [--worlds 20] [--first 0] [--blocked 5] [--robots pioneer amphibious crawler]
        [--jobs 2] [--fit robust] [--stray 0.01] [--duration 240] [--out out/rough] [--json FILE]

The yards are those of `naraha.models.worlds.rough_field`: a bent way through them keeps to slopes, steps and roughness
that every robot here manages, and anything may stand beside it; in the blocked ones a wall keeps every robot from the
goal. Every drive is a `naraha traverse` in a process of its own; those that are there already are not run again.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from naraha.diagrams.campaign import Run, read_metrics, run_in_a_process
from naraha.models.worlds import rough_field

from .report import print_table, write_json

ROBOTS = ("pioneer", "amphibious", "crawler")


def drive(
    robot: str, seed: int, blocked: bool, fit: str, stray: float, duration: float, folder: Path
) -> dict[str, Any]:
    """Metrics of one drive."""
    out = folder / f"{fit}_{stray:g}" / robot / f"{'blocked' if blocked else 'open'}_{seed:03}"
    metrics = read_metrics(out)
    if metrics is None or metrics["status"] == "interrupted":
        yard = rough_field.build(seed, blocked=blocked)
        settings = {
            "recording": "null",
            "world.name": "rough_field_blocked" if blocked else "rough_field",
            "world.seed": str(seed),
            "robot.start_xyz": f"[{yard.start_xy[0]:.4f}, {yard.start_xy[1]:.4f}]",
            "robot.start_yaw_deg": f"{np.rad2deg(yard.start_yaw):.3f}",
            "goal": f"[{yard.goal_xy[0]:.4f}, {yard.goal_xy[1]:.4f}]",
            "duration": str(duration),
            "terrain.fit": fit,
            "lidar.stray": str(stray),
            "local_cloud.dust_gap": "0.1" if stray > 0 else "null",
        }
        words = [word for path, value in settings.items() for word in ("--set", f"{path}={value}")]
        run = Run(
            folder=out, seed=seed, values={}, arguments=("traverse", "--robot", robot, "--seed", str(seed), *words)
        )
        metrics = run_in_a_process((sys.executable, "-m", "naraha.diagrams"), run)
    return metrics


def summary(runs: Sequence[dict[str, Any]], blocked: bool) -> dict[str, float]:
    """Shares and counts of one robot's drives."""
    result = {
        "runs": len(runs),
        "tipped": sum(bool(run.get("tipped")) for run in runs),
        "collisions": sum(int(run.get("collisions", 0)) for run in runs),
    }
    if blocked:
        result["no_way"] = sum(run.get("final_status") == "no way" for run in runs)
    else:
        result["reached"] = sum(bool(run.get("reached")) for run in runs)
        times = [run["time_s"] for run in runs if run.get("reached")]
        result["median_time_s"] = float(np.median(times)) if times else float("nan")
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=20, help="open yards for each robot")
    parser.add_argument("--first", type=int, default=0, help="seed of the first open yard")
    parser.add_argument("--blocked", type=int, default=5, help="blocked yards for each robot")
    parser.add_argument("--robots", nargs="+", choices=ROBOTS, default=ROBOTS)
    parser.add_argument("--fit", choices=("robust", "least_squares"), default="robust")
    parser.add_argument("--duration", type=float, default=240.0, help="simulated time after which a drive is over [s]")
    parser.add_argument("--stray", type=float, default=0.0, help="share of the LiDAR's shots that dust sends back")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--out", type=Path, default=Path("out/rough"))
    parser.add_argument("--json", metavar="FILE", help="where to write the numbers")
    arguments = parser.parse_args()
    plan = [
        (robot, seed, blocked)
        for blocked, first, count in ((False, arguments.first, arguments.worlds), (True, 0, arguments.blocked))
        for seed in range(first, first + count)
        for robot in arguments.robots
    ]
    with ThreadPoolExecutor(arguments.jobs) as pool:
        found = list(
            pool.map(lambda one: drive(*one, arguments.fit, arguments.stray, arguments.duration, arguments.out), plan)
        )
    results: dict[str, object] = {}
    for blocked in (False, True):
        rows = []
        for robot in arguments.robots:
            runs = [run for (r, _, b), run in zip(plan, found, strict=True) if (r, b) == (robot, blocked)]
            numbers = summary(runs, blocked) if runs else {}
            results |= {f"{robot}_{'blocked' if blocked else 'open'}_{key}": value for key, value in numbers.items()}
            rows.append((robot, *numbers.values()))
        if any(len(row) > 1 for row in rows):
            print_table("blocked yards" if blocked else "open yards", ("", *numbers), rows)
    for (robot, seed, blocked), run in zip(plan, found, strict=True):
        good = run.get("final_status") == "no way" if blocked else run.get("reached")
        if not good or run.get("collisions") or run.get("tipped"):
            print(f"{robot} {'blocked' if blocked else 'open'} {seed}: {run.get('status')}: {run.get('reason')}")
    write_json(arguments.json, results)


if __name__ == "__main__":
    main()
