"""`naraha campaign`: a mission over many seeds and a grid of values, one process a run, resumable."""

import csv
import itertools
import json
import math
import os
import statistics
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import joblib
import yaml
from naraha.systems.errors import InputError
from naraha.systems.files import replacing
from pydrake.common.yaml import yaml_load_data
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

BACKENDS = ("loky", "ray")
# A run that ended like this has said what there is to say; an interrupted one is run again.
_ENDED = ("done", "failed")
# Bookkeeping of a mission, which says nothing about what it measured.
_BOOKKEEPING = ("status", "reason", "seed")


@dataclass(frozen=True, kw_only=True)
class Run:
    """One run of a campaign.

    Attributes:
        folder: of its products, named after its values and seed.
        seed: of the mission.
        values: what it has of the grid, as YAML, by path.
        arguments: of the command `naraha` in front of `--out`.
    """

    folder: Path
    seed: int
    values: Mapping[str, str]
    arguments: tuple[str, ...]


@dataclass(kw_only=True)
class Campaign:
    """Which runs, and how many at once.

    Attributes:
        mission: name of a command, such as `survey`; `arguments` are its own, such as a scenario.
        runs: seeds for every point of the grid, from `first_seed` on.
        grid: values in YAML, by the path that `--set` takes.
        jobs: runs at the same time. backend: of joblib, `loky` on this machine or `ray` on a cluster.
        command: what is in front of the mission's name.
    """

    mission: str
    arguments: Sequence[str] = ()
    runs: int = 10
    first_seed: int = 0
    grid: Mapping[str, Sequence[str]] = field(default_factory=dict)
    jobs: int = 1
    backend: str = "loky"
    out: Path = Path("out/campaign")
    command: Sequence[str] = (sys.executable, "-m", "naraha.diagrams")

    def all_runs(self) -> list[Run]:
        """Every seed at every point of the grid, seeds last."""
        found = []
        for point in itertools.product(*self.grid.values()):
            values = dict(zip(self.grid, point, strict=True))
            settings = [word for path, value in values.items() for word in ("--set", f"{path}={value}")]
            # The folder tells the point: a campaign that is widened later finds its runs again.
            name = ",".join(f"{path}={value}" for path, value in values.items())
            name = "".join(c if c.isalnum() or c in "=,.-_" else "_" for c in name)
            for seed in range(self.first_seed, self.first_seed + self.runs):
                folder = self.out / "runs" / "/".join(filter(None, (name, f"seed_{seed:03}")))
                arguments = (self.mission, *self.arguments, *settings, "--seed", str(seed))
                found.append(Run(folder=folder, seed=seed, values=values, arguments=arguments))
        return found


def parse_grid(items: Iterable[str]) -> dict[str, list[str]]:
    """The grid of `path=[value, …]` items of the command line, values as YAML of their own.

    Raises:
        InputError: no path, not a list, or an empty one.
    """
    grid: dict[str, list[str]] = {}
    for item in items:
        where, valid = f"--grid {item}", "path=[value, value], such as lidar.range_noise=[0.01, 0.03]"
        path, equals, text = item.partition("=")
        if not equals or not path:
            raise InputError("not a grid", where=where, valid=valid)
        if path in grid:
            raise InputError("given twice", where=where, key=path)
        try:
            values = yaml_load_data(text, private=True)
        except yaml.YAMLError as error:
            raise InputError(f"not YAML: {' '.join(str(error).split())}", where=where, valid=valid) from None
        if not isinstance(values, list) or not values:
            raise InputError("not a list of values", where=where, value=values, valid=valid)
        grid[path] = [json.dumps(value) for value in values]
    return grid


def run_in_a_process(command: Sequence[str], run: Run) -> dict[str, Any]:
    """Runs a mission in a process of its own and returns its metrics; `status` is `failed` when it left none."""
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    line = [*command, *run.arguments, "--out", str(run.folder)]
    ended = subprocess.run(line, env=environment, capture_output=True, text=True, check=False)
    metrics = read_metrics(run.folder)
    if metrics is None or ended.returncode == 2:
        words = " ".join(ended.stderr.split())[-500:]
        return {"status": "bad input" if ended.returncode == 2 else "failed", "reason": words}
    return metrics


def read_metrics(folder: Path) -> dict[str, Any] | None:
    """What a mission measured, or None where it left nothing that can be read."""
    try:
        metrics = json.loads((folder / "metrics.json").read_text())
    except (OSError, ValueError):
        return None
    return metrics if isinstance(metrics, dict) else None


def run_campaign(campaign: Campaign, console: Console | None = None) -> int:
    """Runs what has not ended yet, and keeps `runs.csv` and `summary.csv` in the campaign's folder up to date.

    `runs.csv` has a row a run: its values of the grid, its seed, and its metrics. `summary.csv` has, for every point
    of the grid and every metric that is a number, count, mean, standard deviation, minimum, median and maximum over
    the runs that are done.

    Returns:
        Exit code: 0 when all runs are done, 1 when some failed, 130 when interrupted; what ended is kept.

    Raises:
        InputError: the first run says that its input is bad, a number is out of range, or there is no such backend.
    """
    console = console or Console(stderr=True)
    _check(campaign)
    runs = campaign.all_runs()
    results: dict[Path, dict[str, Any]] = {}
    for run in runs:
        metrics = read_metrics(run.folder)
        if metrics is not None and metrics.get("status") in _ENDED:
            results[run.folder] = metrics
    pending = [run for run in runs if run.folder not in results]
    if len(pending) < len(runs):
        console.print(f"{len(runs) - len(pending)} of {len(runs)} runs are there already")
    try:
        campaign.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(error.strerror or "cannot be made", where=f"--out {campaign.out}") from None
    interrupted = False
    with _progress(console) as bar:
        task = bar.add_task(campaign.mission, total=len(runs), completed=len(results))
        try:
            for run, metrics in _in_parallel(campaign, pending):
                if metrics["status"] == "bad input" and not results:
                    raise InputError(metrics["reason"].removeprefix("naraha: "), where="first run")
                results[run.folder] = metrics
                _write_runs(campaign, runs, results)
                bar.advance(task)
        except KeyboardInterrupt:
            interrupted = True
    _write_runs(campaign, runs, results)
    summary = summarise(runs, results)
    _write_summary(campaign, summary)
    _print_summary(console, campaign, runs, results, summary)
    if interrupted:
        return 130
    return 0 if all(metrics["status"] == "done" for metrics in results.values()) else 1


def summarise(
    runs: Sequence[Run], results: Mapping[Path, Mapping[str, Any]]
) -> dict[tuple[str, ...], dict[str, dict[str, float]]]:
    """Statistics of every metric that is a number, by point of the grid, over the runs that are done."""
    columns: dict[tuple[str, ...], dict[str, list[float]]] = {}
    for run in runs:
        metrics = results.get(run.folder, {})
        point = columns.setdefault(tuple(run.values.values()), {})
        if metrics.get("status") != "done":
            continue
        for key, value in metrics.items():
            number = isinstance(value, (int, float)) and math.isfinite(value)
            if number and key not in _BOOKKEEPING:
                point.setdefault(key, []).append(float(value))
    return {point: {key: _statistics(v) for key, v in metrics.items()} for point, metrics in columns.items()}


def _statistics(values: Sequence[float]) -> dict[str, float]:
    return {
        "count": len(values),
        "mean": statistics.fmean(values),
        "deviation": statistics.pstdev(values),
        "min": min(values),
        "median": statistics.median(values),
        "max": max(values),
    }


def _check(campaign: Campaign) -> None:
    for name, value in (("--runs", campaign.runs), ("--jobs", campaign.jobs)):
        if value < 1:
            raise InputError("out of range", where=name, value=value, valid=">= 1")
    if campaign.backend not in BACKENDS:
        raise InputError("unknown backend", where="--backend", value=campaign.backend, valid=BACKENDS)
    if campaign.backend == "ray":
        try:
            from ray.util.joblib import register_ray
        except ImportError:
            raise InputError("Ray is not installed", where="--backend ray", valid="pip install 'naraha[ray]'") from None
        register_ray()


def _in_parallel(campaign: Campaign, pending: Sequence[Run]) -> Iterable[tuple[Run, dict[str, Any]]]:
    """Runs with their metrics, in the order in which they end."""

    def one(run: Run) -> tuple[Run, dict[str, Any]]:
        return run, run_in_a_process(campaign.command, run)

    with joblib.parallel_config(backend=campaign.backend, n_jobs=campaign.jobs):
        ended: Iterable[tuple[Run, dict[str, Any]]] = joblib.Parallel(return_as="generator_unordered")(
            joblib.delayed(one)(run) for run in pending
        )
        yield from ended


def _progress(console: Console) -> Progress:
    return Progress(
        TextColumn("[bold]{task.description}"),
        BarColumn(),
        TextColumn("{task.completed} of {task.total} runs"),
        TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )


def _write_runs(campaign: Campaign, runs: Sequence[Run], results: Mapping[Path, Mapping[str, Any]]) -> None:
    keys = list(dict.fromkeys(key for metrics in results.values() for key in metrics if key != "seed"))
    with replacing(campaign.out / "runs.csv") as temporary, temporary.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow([*campaign.grid, "seed", *keys, "folder"])
        for run in runs:
            if run.folder in results:
                metrics = results[run.folder]
                folder = run.folder.relative_to(campaign.out).as_posix()
                table.writerow([*run.values.values(), run.seed, *(metrics.get(key, "") for key in keys), folder])


def _write_summary(campaign: Campaign, summary: Mapping[tuple[str, ...], Mapping[str, Mapping[str, float]]]) -> None:
    with replacing(campaign.out / "summary.csv") as temporary, temporary.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow([*campaign.grid, "metric", "count", "mean", "deviation", "min", "median", "max"])
        for point, metrics in summary.items():
            for key, numbers in metrics.items():
                table.writerow([*point, key, *numbers.values()])


def _print_summary(
    console: Console,
    campaign: Campaign,
    runs: Sequence[Run],
    results: Mapping[Path, Mapping[str, Any]],
    summary: Mapping[tuple[str, ...], Mapping[str, Mapping[str, float]]],
) -> None:
    for point, metrics in summary.items():
        here = [results[run.folder] for run in runs if run.folder in results and tuple(run.values.values()) == point]
        done = sum(one["status"] == "done" for one in here)
        title = ", ".join(f"{path}={value}" for path, value in zip(campaign.grid, point, strict=True))
        table = Table("metric", "mean", "min", "max", title=f"{title or campaign.mission}: {done} of {len(here)} done")
        for key, numbers in metrics.items():
            table.add_row(key, *(f"{numbers[name]:.4g}" for name in ("mean", "min", "max")))
        console.print(table)
    for run in runs:
        metrics = results.get(run.folder, {})
        if metrics.get("status") not in (None, "done"):
            console.print(f"{run.folder}: {metrics['status']}: {metrics.get('reason', '')}", markup=False)
    console.print(f"everything is in {campaign.out}", markup=False)
