"""The planning of `naraha illuminate`: rounds of co-evolution, each verified by runs in physics (S4-e)."""

import csv
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from naraha.systems.config import quantity
from naraha.systems.files import replacing
from naraha.systems.placement import (
    FloorPlan,
    Placement,
    PlacementProblem,
    ProblemConfig,
    Round,
    Rounds,
    RoundsConfig,
    Verification,
    make_problem,
    run_rounds,
)
from pydrake.common.yaml import yaml_load_typed
from rich.console import Console

from .illuminate_drawing import draw_evolution, draw_rounds, save_figure
from .illuminate_log import RunRecord
from .illuminate_run import run_once
from .illuminate_station import MeasuringRoute, MeasuringRunConfig
from .mission import Ending
from .scenario import dump_scenario
from .seeds import sensor_seed


@dataclass(kw_only=True)
class PlanningConfig:
    """How routes and landmarks are planned."""

    problem: ProblemConfig = field(default_factory=ProblemConfig)
    rounds: RoundsConfig = field(default_factory=RoundsConfig)
    # [runs] Every placement is driven so many times, with other noise each time; the worst counts.
    runs: int = quantity(1, unit="runs", low=1)
    # [m] A drive that verifies a placement has failed when the believed position is off by more than this: half of the
    # paper's limit of the run, whose other half is margin for what the run meets and no drive before has met. With
    # errors in x and y that are normal, of runs that follow three drives within it, at most 3 in 100 exceed the whole.
    slam_limit: float = quantity(0.2, unit="m", above=0)
    # [processes] Runs at the same time, on which backend of joblib: `loky`, or `ray` on a cluster.
    jobs: int = quantity(1, unit="processes", low=1)
    backend: str = quantity("loky", choices=("loky", "ray"))


def route_of(placement: Placement) -> MeasuringRoute:
    """What a placement says where to go and what to put up."""
    return MeasuringRoute(placement.route, placement.stops, placement.order - 1, placement.sites)


def verification_of(records: Iterable[RunRecord], slam_limit: float) -> Verification:
    """The worst of the runs of a placement: the first that failed, else that with the largest error.

    Args:
        slam_limit: error of the believed position at which a run has failed [m].
    """
    worst = max(records, key=lambda record: (not record.succeeded, record.slam_errors.max()))
    where = np.array(worst.failed_at) if worst.lost and worst.failed_at is not None else None
    return Verification(
        ok=worst.succeeded,
        max_error=float(worst.slam_errors.max()),
        where=where,
        limit=slam_limit,
        why="" if worst.succeeded else worst.ending.reason,
    )


@dataclass(frozen=True)
class VerifyInPhysics:
    """The high fidelity: measuring runs of a placement in MultibodyPlant with laser, localisation and behaviours.

    Attributes:
        config: of the runs. seed: of the mission; the seeds of the runs are drawn from it.
        slam_limit: error of the believed position at which a run has failed [m]. runs: of every placement.
    """

    config: MeasuringRunConfig
    seed: int
    slam_limit: float
    runs: int = 1

    def __call__(self, plan: FloorPlan, placement: Placement, sites: np.ndarray) -> Verification:
        way = replace(route_of(placement), sites=sites)
        records = []
        for i in range(self.runs):
            seed = sensor_seed(self.seed, f"verification {i}")
            records.append(run_once(self.config, plan, way, seed, self.slam_limit))
            if not records[-1].succeeded:
                break
        return verification_of(records, self.slam_limit)

    def __reduce__(self) -> tuple[Callable[..., "VerifyInPhysics"], tuple[str, int, float, int]]:
        """For another process: Drake's configurations cannot be pickled, and travel as YAML."""
        return _verify_from_text, (dump_scenario(self.config), self.seed, self.slam_limit, self.runs)


def _verify_from_text(text: str, seed: int, slam_limit: float, runs: int) -> VerifyInPhysics:
    return VerifyInPhysics(yaml_load_typed(schema=MeasuringRunConfig, data=text), seed, slam_limit, runs)


@dataclass(frozen=True, eq=False)
class Planned:
    """Where to go and what to put up.

    Attributes:
        way: of the measuring run. ending: why there is none, when planning was interrupted or found nothing.
        rounds: all rounds so far. best: what came of them, None when nothing did.
        problem: what was planned on, None when nothing was.
    """

    way: MeasuringRoute
    ending: Ending | None = None
    rounds: tuple[Round, ...] = ()
    best: Placement | None = None
    problem: PlacementProblem | None = None

    def metrics(self) -> dict[str, Any]:
        """Flat; lists are text with commas."""
        numbers = [int(r.placement.chosen.sum()) for r in self.rounds]
        return {
            "rounds": len(self.rounds),
            "landmarks": len(self.way.sites),
            "landmarks_per_round": ", ".join(map(str, numbers)),
            "rounds_failed": sum(not r.verification.ok for r in self.rounds),
            "planned_length_m": _length(self.way),
        }

    def write(self, path: Callable[[str], Path]) -> None:
        """Writes `rounds.csv`, a line a round, and pictures of them, when there were any.

        Args:
            path: gives the path of a product.
        """
        if not self.rounds or self.problem is None:
            return
        columns = ["round", "lower_bound", "landmarks", "length_m", "expected_error_m", "side_score", "succeeded"]
        columns += ["largest_error_m", "failed_x_m", "failed_y_m", "reason"]
        with replacing(path("rounds.csv")) as temporary, temporary.open("w", newline="") as file:
            table = csv.writer(file)
            table.writerow(columns)
            for i, r in enumerate(self.rounds, 1):
                p, v = r.placement, r.verification
                where = ["", ""] if v.where is None else [f"{value:.2f}" for value in v.where]
                numbers = [f"{p.length:.1f}", f"{p.largest_error:.3f}", f"{p.side_score:.3f}"]
                table.writerow([i, r.least, int(p.chosen.sum()), *numbers, v.ok, f"{v.max_error:.3f}", *where, v.why])
        save_figure(draw_rounds(self.problem, self.rounds), path("rounds.png"))
        save_figure(draw_evolution(self.rounds), path("evolution.png"))


def _length(way: MeasuringRoute) -> float:
    return float(np.hypot(*np.diff(way.route, axis=0).T).sum())


def plan_measuring(
    config: PlanningConfig,
    run: MeasuringRunConfig,
    plan: FloorPlan,
    seed: int,
    *,
    console: Console,
) -> Planned:
    """Evolves routes and landmarks in rounds, each verified in physics, and takes the best that succeeded.

    The boxes that are planned with are those of `run.hall`.

    Raises:
        ConfigError, PlanError: nothing can be planned for this.
    """
    sites = replace(config.problem.sites, side=run.hall.box_side)
    problem = make_problem(plan, replace(config.problem, sites=sites))
    rounds_config = replace(config.rounds, evolution=replace(config.rounds.evolution, seed=seed))
    # What travels to another process is the run's own configuration, not that of the planning around it.
    plain = {name: getattr(run, name) for name in MeasuringRunConfig.__dataclass_fields__}
    verify = VerifyInPhysics(MeasuringRunConfig(**plain), seed, config.slam_limit, config.runs)
    done: list[Round] = []

    def report(r: Round) -> None:
        done.append(r)
        number, verdict = int(r.placement.chosen.sum()), r.verification
        words = "succeeded" if verdict.ok else f"failed: {verdict.why}"
        line = f"round {len(done)}: at least {r.least}, {number} landmarks, {r.placement.length:.0f} m, "
        console.print(f"{line}error {verdict.max_error:.2f} m, {words}", markup=False, highlight=False, soft_wrap=True)

    def in_parallel(function: Callable[..., Verification], *sequences: Iterable[Any]) -> Iterable[Verification]:
        with joblib.parallel_config(backend=config.backend, n_jobs=config.jobs):
            jobs = (joblib.delayed(function)(*arguments) for arguments in zip(*sequences, strict=True))
            yield from joblib.Parallel(return_as="generator")(jobs)

    nowhere = MeasuringRoute(plan.start[None, :2], np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)))
    try:
        rounds: Rounds = run_rounds(
            problem, verify, rounds_config, map_=map if config.jobs == 1 else in_parallel, report=report
        )
    except KeyboardInterrupt:
        ending = Ending("interrupted", f"interrupted while planning, after {len(done)} rounds")
        return Planned(nowhere, ending, tuple(done), problem=problem)
    best = rounds.best
    if best is None:
        ending = Ending("failed", f"none of {len(done)} rounds found a placement that succeeds")
        return Planned(nowhere, ending, rounds.rounds, problem=rounds.problem)
    return Planned(route_of(best.placement), None, rounds.rounds, best.placement, rounds.problem)
