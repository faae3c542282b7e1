"""What happens in a recovery, move by move, and what is measured of it."""

from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field

import numpy as np
from naraha.models.worlds.stuck import StuckCase
from naraha.systems.config import quantity
from naraha.systems.snake.recovery_planner import Proposal, RankedProposal, Rehearsal
from naraha.systems.snake.snake_pilot import Move
from naraha.systems.snake.stuck_rules import Diagnosis

from .mission import Ending
from .recording import RecordingConfig
from .recover_metrics import RecoverMetrics, control_pose
from .snake_belief import Belief, believe
from .snake_moves import SnakeMovesConfig, SnakeRun
from .snake_rehearsal import RehearsedPlan, plan

STEP = 0.05
"""[s] at which the mission looks at the robot."""

Choose = Callable[[tuple[RankedProposal, ...]], int]
"""Asks which of some ranked proposals to carry out; -1 for none."""


@dataclass(kw_only=True)
class RecoverScenario(SnakeMovesConfig):
    """A stuck snake and what is to be done about it."""

    description: str = ""
    seed: int = quantity(0, low=0)
    # Class of the stuck state, 1 to 5, of which the seed draws one; see `naraha.models.worlds.stuck`.
    stuck: int = quantity(1, low=1, high=5)
    # False draws a world in which the snake is not stuck.
    really: bool = True
    # Who chooses: auto takes the proposal whose rehearsal went best, prompt asks.
    operator: str = quantity("auto", choices=("auto", "prompt"))
    # Whether proposals are rehearsed on a copy of the model; in their first order otherwise.
    rehearse: bool = True
    # Whether the cheap moves of an operator are proposed, too.
    cheap_moves: bool = True
    # Time to come to rest, and with the wheels turning, before anybody asks.
    rest_time: float = quantity(1.5, unit="s", above=0.0)
    stuck_time: float = quantity(3.0, unit="s", above=0.0)
    # What has to be driven on for the snake to be free, and the time for it.
    free_advance: float = quantity(0.5, unit="m", above=0.0)
    drive_time: float = quantity(9.0, unit="s", above=0.0)
    # Most attempts, and the time for everything.
    attempts: int = quantity(4, low=1)
    duration: float = quantity(120.0, unit="s", above=0.0)
    recording: RecordingConfig | None = field(
        default_factory=lambda: RecordingConfig(camera=[-0.1, -1.35, 0.95], target=[-0.15, 0.5, 0.2])
    )


class RecoverScript:
    """The mission as a sequence of moves; `steps` is advanced by whoever simulates, every `STEP`."""

    def __init__(
        self, scenario: RecoverScenario, case: StuckCase, run: SnakeRun, choose: Choose, say: Callable[[str], None]
    ):
        self.scenario, self.case, self.run = scenario, case, run
        self.metrics = RecoverMetrics(true_class=case.kind if case.stuck else 0, true_unit=case.unit)
        self.plan: RehearsedPlan | None = None
        self.rows: list[list[float]] = []
        self.phase = "rest"
        self.ending = Ending("failed", "it did not come to an end")
        self._choose, self._say = choose, say
        self._start = run.head()

    def steps(self) -> Iterator[None]:
        """Yields when the robot is to be simulated on; returns when the mission is over. `ending` says how."""
        scenario, run, metrics = self.scenario, self.run, self.metrics
        run.give(Move(joints=tuple(float(q) for q in self.case.joint_command)))
        yield from self._wait(scenario.rest_time)
        self.phase, start = "drive", run.head()
        run.give(Move(kind="wheels", speed=scenario.planner.speed))
        diagnosis = yield from self._watch_for_stuck()
        metrics.stuck_advance_m = float((run.head() - start)[0])
        metrics.detected, metrics.detected_class = diagnosis.stuck, diagnosis.kind
        metrics.detected_unit, metrics.detection_confidence = diagnosis.unit, diagnosis.confidence
        proposals = run.read("planner.proposals").items
        belief = self._believe(diagnosis)
        run.give(Move())
        yield from self._wait(0.3)
        if not diagnosis.stuck:
            self.ending = Ending("done", "it is not stuck")
            return
        self._say(f"stuck at unit {diagnosis.unit}: {diagnosis.in_words} (class {diagnosis.kind})")
        wanted = tuple(p for p in proposals if scenario.cheap_moves or not p.cheap)
        ranked = self._rank(belief, wanted)
        yield from self._try(ranked)

    def _watch_for_stuck(self) -> Generator[None, None, Diagnosis]:
        """Drives for `stuck_time`; returns the diagnosis some moments after the first that says stuck."""
        found, since = Diagnosis(), np.inf
        until = self.run.time + self.scenario.stuck_time
        while self.run.time < until - 1e-9:
            yield
            diagnosis = self.run.read("detector.diagnosis")
            since = min(since, self.run.time) if diagnosis.stuck else since
            if diagnosis.stuck and self.run.time <= since + 0.3 + 1e-9:
                found = diagnosis
        return found

    def _believe(self, diagnosis: Diagnosis) -> Belief:
        run = self.run
        return believe(
            diagnosis,
            joint_angles=run.read("actuators.reported_joint_angles"),
            joint_command=run.read("pilot.joint_command"),
            rpy=run.read("station.rpy"),
            ranges=run.read("station.ranges"),
            snake=self.scenario.snake,
        )

    def _rank(self, belief: Belief, proposals: tuple[Proposal, ...]) -> tuple[RankedProposal, ...]:
        if not self.scenario.rehearse:
            nothing = Rehearsal(np.nan, np.nan, np.nan, np.nan, np.nan, np.nan)
            return tuple(RankedProposal(p, nothing, 0.0) for p in proposals)

        def said(proposal: Proposal, result: Rehearsal) -> None:
            self._say(f"rehearsed: {label_of(proposal)}: drives on for {result.advance:.2f} m")

        self.phase = "rehearse"
        self.plan = plan(self.scenario, belief, proposals, said)
        self.metrics.rehearsal_faithful = self.plan.faithful
        return self.plan.ranked

    def _try(self, ranked: tuple[RankedProposal, ...]) -> Iterator[None]:
        scenario, metrics = self.scenario, self.metrics
        left = list(ranked)
        while left and metrics.attempts < scenario.attempts:
            index = self._choose(tuple(left))
            if index < 0:
                break
            chosen = left.pop(index)
            metrics.attempts += 1
            metrics.move = label_of(chosen.proposal)
            self._say(f"attempt {metrics.attempts}: {metrics.move}")
            yield from self._perform(chosen.proposal)
            yield from self._drive_on()
            if metrics.freed:
                self.ending = Ending("done", f"freed in attempt {metrics.attempts}: {metrics.move}")
                return
        reason = f"not freed in {metrics.attempts} attempts" if metrics.attempts else "nothing was tried"
        self.ending = Ending("failed", reason)

    def _perform(self, proposal: Proposal) -> Iterator[None]:
        run, metrics = self.run, self.metrics
        start = self._start = run.head()
        self.phase, first = "free", True
        farthest, worst = 0.0, np.nan
        for planned, seconds in proposal.moves:
            move, until = run.give(planned), run.time + seconds
            while run.time < until - 1e-9:
                yield
                self._record()
                farthest = max(farthest, float(np.linalg.norm(run.head() - start)))
                if move.kind != "recover":
                    continue
                status = run.read("recovery.status")
                if status.number != move.number:
                    continue
                worst = np.fmax(worst, np.linalg.norm(status.control_error[:3]))
                if first and np.isfinite(status.distance):
                    metrics.target_distance_start_m, first = float(status.distance), False
                if status.phase in ("done", "stopped", "refused"):
                    self._say(f"recovery {status.phase}: {status.reason}")
                    break
            if move.kind == "recover":
                metrics.control_point_error_m = float(np.linalg.norm(run.read("recovery.control_error")[:3]))
                metrics.target_distance_end_m = float(run.read("recovery.target_distance")[0])
        metrics.head_motion_m, metrics.control_point_error_max_m = farthest, float(worst)

    def _drive_on(self) -> Iterator[None]:
        scenario, run, metrics = self.scenario, self.run, self.metrics
        self.phase, start = "drive on", run.head()
        run.give(Move(kind="shift", speed=scenario.planner.speed))
        until = run.time + scenario.drive_time
        while run.time < until - 1e-9:
            yield
            metrics.advance_after_m = float((run.head() - start)[0])
            if metrics.advance_after_m >= scenario.free_advance:
                metrics.freed = True
                break
        run.give(Move())
        yield from self._wait(0.3)

    def _wait(self, seconds: float) -> Iterator[None]:
        until = self.run.time + seconds
        while self.run.time < until - 1e-9:
            yield

    def watch(self) -> None:
        """Keeps the smallest margins and the largest tilt; called after every step."""
        run, metrics = self.run, self.metrics
        if self.phase in ("rest", "drive"):
            return
        limits = np.array(self.scenario.snake.joint_limits())
        margin = float(np.min(limits - np.abs(run.read("station.joint_angles"))))
        metrics.min_limit_margin_rad = min(metrics.min_limit_margin_rad, margin)
        metrics.max_tilt_rad = max(metrics.max_tilt_rad, abs(float(run.read("station.rpy")[0])))
        if self.phase == "free":
            margin = float(run.read("station.tip_margin")[0])
            metrics.min_tip_margin_m = min(metrics.min_tip_margin_m, margin)

    def _record(self) -> None:
        run, status = self.run, self.run.read("recovery.status")
        pose, reference = control_pose(status)
        limits = np.array(self.scenario.snake.joint_limits())
        joints = float(np.min(limits - np.abs(run.read("station.joint_angles"))))
        head = float(np.linalg.norm(run.head() - self._start))
        controlled = [*reference, *pose, *status.control_error, status.distance, status.manipulability]
        self.rows.append([run.time, *controlled, joints, *run.read("station.tip_margin"), head])


def label_of(proposal: Proposal) -> str:
    """The moves of a proposal in words."""
    return ", then ".join(move.label for move, _ in proposal.moves)
