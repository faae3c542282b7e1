"""`naraha recover`: the snake notices that it is stuck, says how, and frees itself (rows S1-a to S1-g)."""

import csv

import numpy as np
from naraha.models.worlds.stuck import StuckCase, stuck_case
from naraha.systems.errors import ConfigError
from naraha.systems.files import replacing
from naraha.systems.snake.recovery_planner import RankedProposal
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context

from .mission import Ending, Mission, Options
from .recording import start_meshcat, write_recording
from .recover_drawing import draw_recovery
from .recover_metrics import COLUMNS
from .recover_script import STEP, RecoverScenario, RecoverScript, label_of
from .snake_moves import SnakeRun, make_snake_moves


def choose_best(ranked: tuple[RankedProposal, ...]) -> int:
    """The first: best when they were rehearsed. Those with an objection come last and are tried only then."""
    return 0 if ranked else -1


def ask(ranked: tuple[RankedProposal, ...]) -> int:
    """Asks on the terminal."""
    for i, item in enumerate(ranked, 1):
        result = item.rehearsal
        note = item.objection or f"drives on for {result.advance:.2f} m, {1e3 * result.tip_margin:.0f} mm from tipping"
        print(f"{i:3}  {label_of(item.proposal)}: {note}")
    while True:
        try:
            answer = input(f"Which one, 1 to {len(ranked)}, or nothing to stop? ").strip()
        except EOFError:
            return -1
        if not answer:
            return -1
        if answer.isdigit() and 1 <= int(answer) <= len(ranked):
            return int(answer) - 1


def make_recover(scenario: RecoverScenario, meshcat: Meshcat | None = None) -> tuple[StuckCase, SnakeRun]:
    """Draws the case and builds the robot in it."""
    case = stuck_case(scenario.stuck, scenario.seed, stuck=scenario.really, snake=scenario.snake)
    if None in (scenario.imu, scenario.pads, scenario.ranges):
        raise ConfigError("the mission needs all sensors", key="imu, pads, ranges", valid="not null")
    diagram = make_snake_moves(
        scenario,
        case.world,
        X_WB=case.X_WB,
        joint_angles=case.joint_angles,
        seed=scenario.seed,
        meshcat=meshcat,
    )
    return case, SnakeRun(diagram)


def recover(scenario: RecoverScenario, options: Options) -> int:
    """Runs the mission, writes its products, and returns the exit code."""
    mission = Mission("recover", scenario, options)
    meshcat = start_meshcat(scenario.recording, live=options.meshcat) if scenario.recording is not None else None
    case, run = make_recover(scenario, meshcat)
    choose = ask if scenario.operator == "prompt" else choose_best

    def say(line: str) -> None:
        options.console.print(line, markup=False, highlight=False)

    script = RecoverScript(scenario, case, run, choose, say)
    steps = script.steps()

    def on_step(context: Context) -> Ending | None:
        script.watch()
        try:
            next(steps)
        except StopIteration:
            return script.ending
        return None

    ending = mission.simulate(
        run.simulator,
        duration=scenario.duration,
        step=STEP,
        on_step=on_step,
        status_line=lambda context: script.phase,
    )

    def write_metrics() -> None:
        mission.metrics.update(vars(script.metrics))

    def write_recovery() -> None:
        with replacing(mission.path("recovery.csv")) as path, path.open("w", newline="") as file:
            table = csv.writer(file)
            table.writerow(COLUMNS)
            table.writerows([f"{value:.6g}" for value in row] for row in script.rows)

    def write_drawing() -> None:
        if any(np.isfinite(row[COLUMNS.index("control_x_m")]) for row in script.rows):
            with replacing(mission.path("recovery.png")) as path:
                draw_recovery(np.array(script.rows)).savefig(path, format="png", dpi=110)

    def write_rehearsals() -> None:
        if script.plan is None:
            return
        with replacing(mission.path("rehearsals.csv")) as path, path.open("w", newline="") as file:
            table = csv.writer(file)
            names = ("advance", "head_motion", "tip_margin", "joint_margin", "control_error", "duration", "reason")
            table.writerow(["proposal", "score", "objection", *names])
            for item in script.plan.ranked:
                result = [getattr(item.rehearsal, name) for name in names]
                table.writerow([label_of(item.proposal), f"{item.score:.4g}", item.objection, *result])

    def write_html() -> None:
        if meshcat is not None:
            write_recording(meshcat, mission.path("recording.html"))

    return mission.finish(ending, write_metrics, write_recovery, write_drawing, write_rehearsals, write_html)


__all__ = ["RecoverScenario", "RecoverScript", "ask", "choose_best", "make_recover", "recover"]
