"""The snake in random stuck worlds: what it notices, how it frees itself, and what each part of the method is worth.

    python -m tests.benchmarks.snake_cases [--parts methods,terms] [--cases 2] [--kinds 1,2,3,4,5] [--jobs 1]
        [--first 1000] [--json FILE]

methods: one move each, chosen by nobody, in the stuck worlds: null-space recovery, its ablations, and what an operator
would try first. terms: postures in which single terms of the cost matter. detection: stuck and not-stuck runs of every
class. freeing: the whole mission, the planner chooses. The last two with 50 cases a class take hours.
"""

import argparse
import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np
from naraha.diagrams.recover import RecoverScenario, RecoverScript, choose_best, make_recover
from naraha.diagrams.snake_rehearsal import STEP
from naraha.models.worlds.stuck import KINDS
from naraha.systems.snake.snake_pilot import Move
from naraha.systems.snake.stuck_rules import Diagnosis

from .report import print_table, use_one_core, write_json
from .snake_ablations import (
    CHEAP,
    METHODS,
    POSTURES,
    SPEED,
    UNBOUNDED,
    Outcome,
    in_kinematics,
    in_physics,
    in_stuck_world,
)


def spread(function: Callable[..., Any], tasks: Sequence[tuple[Any, ...]], jobs: int) -> list[Any]:
    """Results of `function` for every tuple of arguments, in order.

    Every few tasks get new processes: Drake's systems written in Python are not all freed, and a pool that replaces
    its workers itself (`max_tasks_per_child`) was seen to stand still in Python 3.12.
    """
    results: list[Any] = []
    batch = 25 * jobs
    for i in range(0, len(tasks), batch):
        initializer = use_one_core if jobs == 1 else None
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(jobs, mp_context=context, initializer=initializer) as pool:
            results += pool.map(function, *zip(*tasks[i : i + batch], strict=True))
    return results


def notice(kind: int, seed: int, stuck: bool) -> tuple[Diagnosis, float, int]:
    """What the detector says while the wheels turn for 3 s, how far the nose got [m], and the true unit."""
    case, run = make_recover(RecoverScenario(stuck=kind, seed=seed, really=stuck))
    run.give(Move(joints=tuple(float(q) for q in case.joint_command)))
    run.advance(1.5)
    start, found, since = run.head(), Diagnosis(), np.inf
    # A snake that is not stuck climbs the step by shift control, the others drive as those do that are stuck.
    run.give(Move(kind="shift" if kind == 5 and not stuck else "wheels", speed=SPEED))
    for _ in range(round(3.0 / STEP)):
        run.advance(STEP)
        diagnosis = run.read("detector.diagnosis")
        since = min(since, run.time) if diagnosis.stuck else since
        if diagnosis.stuck and run.time <= since + 0.3 + 1e-9:
            found = diagnosis
    return found, float((run.head() - start)[0]), case.unit


def free_itself(kind: int, seed: int) -> dict[str, float]:
    """The whole mission, without a recording."""
    scenario = RecoverScenario(stuck=kind, seed=seed, recording=None)
    case, run = make_recover(scenario)
    script = RecoverScript(scenario, case, run, choose_best, lambda line: None)
    for _ in script.steps():
        run.advance(STEP)
        script.watch()
    return vars(script.metrics)


def detection(kinds: list[int], seeds: list[int], free_seeds: list[int], jobs: int) -> dict[str, float]:
    """Rates of detection, of right classes and places, and of false alarms."""
    results: dict[str, float] = {}
    rows = []
    for kind in kinds:
        stuck = spread(notice, [(kind, seed, True) for seed in seeds], jobs)
        free = spread(notice, [(kind, seed, False) for seed in free_seeds], jobs)
        row = {
            "detected": np.mean([d.stuck for d, _, _ in stuck]),
            "class_right": np.mean([d.kind == kind for d, _, _ in stuck]),
            "place_right": np.mean([d.stuck and abs(d.unit - unit) <= 1 for d, _, unit in stuck]),
            "false_alarms": np.mean([d.stuck for d, _, _ in free]) if free else np.nan,
            "stuck_advance_max_m": max(abs(advance) for _, advance, _ in stuck),
            "free_advance_min_m": min((advance for _, advance, _ in free), default=np.nan),
        }
        rows.append((kind, *(float(value) for value in row.values())))
        results |= {f"naraha_stuck_{kind}_{name}": float(value) for name, value in row.items()}
    title = f"Detection: {len(seeds)} stuck and {len(free_seeds)} free runs of each class"
    columns = (
        "class",
        "detected",
        "class right",
        "within one unit",
        "false alarms",
        "stuck: m in 3 s",
        "free: m in 3 s",
    )
    print_table(title, columns, rows)
    return results


def freeing(kinds: list[int], seeds: list[int], jobs: int) -> dict[str, float]:
    """Rates of missions that free the snake, and what they cost."""
    results: dict[str, float] = {}
    rows = []
    for kind in kinds:
        runs = spread(free_itself, [(kind, seed) for seed in seeds], jobs)
        moves = [str(run["move"]).split(" with")[0] for run in runs]
        row = {
            "freed": np.mean([run["freed"] for run in runs]),
            "attempts": np.mean([run["attempts"] for run in runs]),
            "null_space_share": np.mean([move == "recover" for move in moves]),
            "head_motion_max_m": np.nanmax([run["head_motion_m"] for run in runs]),
            "control_error_max_m": np.nanmax([run["control_point_error_m"] for run in runs] + [0.0]),
            "tip_margin_min_m": min(run["min_tip_margin_m"] for run in runs),
            "tilt_max_deg": np.rad2deg(max(run["max_tilt_rad"] for run in runs)),
            "faithful": np.mean([run["rehearsal_faithful"] for run in runs]),
        }
        rows.append((kind, *(float(value) for value in row.values())))
        results |= {f"naraha_free_{kind}_{name}": float(value) for name, value in row.items()}
    columns = (
        "class",
        "freed",
        "attempts",
        "by recovery",
        "head [m]",
        "control [m]",
        "tip [m]",
        "tilt [°]",
        "faithful",
    )
    print_table(f"Freeing: {len(seeds)} missions of each class", columns, rows)
    return results


def methods(kinds: list[int], seeds: list[int], jobs: int) -> dict[str, float]:
    """One move each, at the true unit: what frees in which class, and at what cost."""
    results: dict[str, float] = {}
    rows: list[list[object]] = []
    tasks = [(kind, seed, name) for kind in kinds for name in (*METHODS, *CHEAP) for seed in seeds]
    outcomes = dict(zip(tasks, spread(in_stuck_world, tasks, jobs), strict=True))
    for kind in kinds:
        for name in (*METHODS, *CHEAP):
            runs = [outcomes[kind, seed, name] for seed in seeds]
            freed, costs = float(np.mean([run.ok for run in runs])), costs_of(runs)
            label = f"{'naraha' if name == 'recovery' else name}_{kind}"
            results |= {f"{label}_freed": freed} | {f"{label}_{key}": value for key, value in costs.items()}
            rows.append([kind, name, freed, *costs.values()])
    columns = ["class", "move", "freed", "s", "head mm", "control mm", "joints °", "tip mm"]
    print_table(f"One move, {len(seeds)} cases of each class: mean time, worst of the rest", columns, rows)
    return results


def terms(kinematic: int, physical: int, jobs: int) -> dict[str, float]:
    """Postures in which single terms matter, as pure kinematics and in physics on flat ground."""
    results: dict[str, float] = {}
    for where, function, count in (("kinematics", in_kinematics, kinematic), ("physics", in_physics, physical)):
        rows: list[list[object]] = []
        tasks = [(f, seed, name) for f in POSTURES for name in (*METHODS, *UNBOUNDED) for seed in range(count)]
        outcomes = dict(zip(tasks, spread(function, tasks, jobs), strict=True))
        for family in POSTURES:
            for name in (*METHODS, *UNBOUNDED):
                runs = [outcomes[family, seed, name] for seed in range(count)]
                done, costs = float(np.mean([run.ok for run in runs])), costs_of(runs)
                label = f"{'naraha' if name == 'recovery' else name}_{family}_{where}"
                results |= {f"{label}_done": done} | {f"{label}_{key}": value for key, value in costs.items()}
                rows.append([family, name, done, *costs.values()])
        columns = ["posture", "method", "done", "s", "head mm", "control mm", "joints °", "tip mm"]
        print_table(f"Where terms matter, {where}, {count} postures each: mean time, worst of the rest", columns, rows)
    return results


def costs_of(outcomes: Sequence[Outcome]) -> dict[str, float]:
    """Mean time, worst head motion and control error, smallest margins; NaN where there is none."""

    def worst(values: list[float], pick: Callable[[list[float]], float]) -> float:
        finite = [value for value in values if np.isfinite(value) and abs(value) < 100]
        return float(pick(finite)) if finite else np.nan

    return {
        "time_s": float(np.mean([o.time for o in outcomes])),
        "head_mm": 1e3 * worst([o.head for o in outcomes], max),
        "control_mm": 1e3 * worst([o.control for o in outcomes], max),
        "joint_margin_deg": float(np.rad2deg(worst([o.joints for o in outcomes], min))),
        "tip_margin_mm": 1e3 * worst([o.tip for o in outcomes], min),
    }


def recovery_scene() -> dict[str, float]:
    """A short version for `tests.benchmarks.snake --scene recovery`: ten cases of each class, one of each method."""
    kinds, seeds = list(KINDS), list(range(1000, 1010))
    results = detection(kinds, seeds, seeds[:5], 1)
    return results | freeing(kinds, seeds[:2], 1) | methods(kinds, seeds[:1], 1) | terms(6, 1, 1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", default="methods,terms")
    parser.add_argument("--cases", type=int, default=2)
    parser.add_argument("--free-cases", type=int, default=20)
    parser.add_argument("--kinds", default=",".join(map(str, KINDS)))
    parser.add_argument("--first", type=int, default=1000, help="first seed")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--json", metavar="FILE", help="where to write the numbers")
    arguments = parser.parse_args()
    kinds = [int(kind) for kind in arguments.kinds.split(",")]
    seeds = list(range(arguments.first, arguments.first + arguments.cases))
    free_seeds = list(range(arguments.first, arguments.first + arguments.free_cases))
    parts, results = arguments.parts.split(","), {}
    if "detection" in parts:
        results |= detection(kinds, seeds, free_seeds, arguments.jobs)
    if "freeing" in parts:
        results |= freeing(kinds, seeds, arguments.jobs)
    if "methods" in parts:
        results |= methods(kinds, seeds, arguments.jobs)
    if "terms" in parts:
        results |= terms(12, 2, arguments.jobs)
    write_json(arguments.json, results)


if __name__ == "__main__":
    main()
