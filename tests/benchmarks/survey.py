"""The shipped survey over many seeds, and the hall surveyed again after its crates have changed.

    python -m tests.benchmarks.survey --seeds 20 --out out/surveys [--later] [--baseline] [--jobs 2] [--json FILE]

`--baseline` runs the source's ICP (S0-g) beside ours, whose errors are then told too.

Every run is a `naraha survey` in a process of its own; those that are there already are not run again.
"""

import argparse
import os
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from naraha.diagrams.campaign import Run, read_metrics, run_in_a_process

from .report import print_table, write_json

QUICK = ["--set", "recording=null"]
# What is reported of each kind of run.
KEYS = {
    "before": [
        "water_iou_with_threshold",
        "water_iou_with_range",
        "water_iou_with_tilt",
        "water_iou",
        "puddles_found",
        "puddles_false_with_threshold",
        "puddles_false_with_range",
        "puddles_false_with_tilt",
        "puddles_false",
        "heat_iou",
        "source_error_horizontal_m",
        "source_error_m",
        "dose_map_error",
        "trajectory_error_mean_m",
        "map_error_m",
        "odometry_trajectory_error_mean_m",
        "odometry_map_error_m",
        "baseline_trajectory_error_mean_m",
        "baseline_map_error_m",
    ],
    "later": [
        "changes_visible",
        "changes_found",
        "changes_reported",
        "changes_right",
        "changes_precision",
        "changes_recall",
    ],
}


def survey(out: Path, seed: int, settings: list[str]) -> dict[str, Any]:
    """Runs a survey into `out`, unless it is there, and returns its metrics."""
    metrics = read_metrics(out)
    if metrics is None or metrics["status"] != "done":
        arguments = ("survey", "stair_hall", *QUICK, "--seed", str(seed), *settings)
        run = Run(folder=out, seed=seed, values={}, arguments=arguments)
        metrics = run_in_a_process((sys.executable, "-m", "naraha.diagrams"), run)
    return metrics


def survey_seed(seed: int, folder: Path, later: bool, baseline: bool) -> dict[str, dict[str, Any]]:
    """The survey of one seed, and the later one."""
    before = folder / f"seed_{seed:02}"
    quick = [] if baseline else ["--set", "baseline=null"]
    runs = {"before": survey(before, seed, quick)}
    if later:
        settings = [*quick, "--set", "world.name=stair_hall_later", "--earlier", str(before)]
        runs["later"] = survey(folder / f"seed_{seed:02}_later", seed, settings)
    return runs


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--later", action="store_true", help="survey the changed hall, too")
    parser.add_argument("--baseline", action="store_true", help="run the source's ICP beside ours")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--out", type=Path, default=Path("out/surveys"))
    parser.add_argument("--json", metavar="FILE", help="where to write the numbers")
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    with ThreadPoolExecutor(arguments.jobs) as pool:
        runs = list(pool.map(lambda seed: survey_seed(seed, arguments.out, arguments.later, arguments.baseline), seeds))
    results: dict[str, object] = {}
    for kind, keys in KEYS.items():
        done = [run[kind] for run in runs if kind in run and run[kind].get("status") == "done"]
        if not any(kind in run for run in runs):
            continue
        rows = []
        for key in keys:
            values = np.array([run[key] for run in done if run.get(key) is not None], float)
            if not len(values):
                continue
            summary = {"mean": values.mean(), "median": np.median(values), "min": values.min(), "max": values.max()}
            rows.append((key, *(float(value) for value in summary.values())))
            results |= {f"{key}_{name}": float(value) for name, value in summary.items()}
        results[f"{kind}_done"], results[f"{kind}_runs"] = len(done), len(runs)
        print_table(f"{kind}: {len(done)} of {len(runs)} runs done", ("", "mean", "median", "min", "max"), rows)
    write_json(arguments.json, results)


if __name__ == "__main__":
    main()
