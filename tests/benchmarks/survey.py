"""The shipped survey over many seeds, and the hall surveyed again after its crates have changed.

    python -m tests.benchmarks.survey --seeds 20 --out out/surveys [--later] [--baseline] [--jobs 2] [--json FILE]

`--baseline` runs the source's ICP (S0-g) beside ours, whose errors are then told too.

Every run is a `naraha survey` in a process of its own; those that are there already are not run again.
"""

import argparse
import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

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


def survey(out: Path, arguments: list[str]) -> dict[str, float]:
    """Runs a survey into `out`, unless it is there, and returns its metrics."""
    file = out / "metrics.json"
    if not file.is_file() or json.loads(file.read_text())["status"] != "done":
        command = [sys.executable, "-m", "naraha.diagrams", "survey", "--out", str(out), *QUICK, *arguments]
        environment = os.environ | {"OMP_NUM_THREADS": "1"}
        subprocess.run(command, env=environment, capture_output=True, check=False)
    metrics: dict[str, float] = json.loads(file.read_text()) if file.is_file() else {"status": "failed"}  # type: ignore[dict-item]
    return metrics


def survey_seed(seed: int, folder: Path, later: bool, baseline: bool) -> dict[str, dict[str, float]]:
    """The survey of one seed, and the later one."""
    before = folder / f"seed_{seed:02}"
    quick = [] if baseline else ["--set", "baseline=null"]
    runs = {"before": survey(before, ["--seed", str(seed), *quick])}
    if later:
        arguments = ["--seed", str(seed), *quick, "--set", "world.name=stair_hall_later", "--earlier", str(before)]
        runs["later"] = survey(folder / f"seed_{seed:02}_later", arguments)
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
