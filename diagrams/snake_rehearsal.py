"""Tries ways out on a copy of the snake in the surroundings that it believes in, before the snake does."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from naraha.models.worlds import World
from naraha.systems.snake.recovery_planner import Proposal, RankedProposal, Rehearsal, rank
from naraha.systems.snake.snake_pilot import Move
from pydrake.math import RigidTransform

from .snake_belief import Belief
from .snake_moves import SnakeMovesConfig, SnakeRun, make_snake_moves

# A copy that is to be as stuck as the robot moves less than this in `TEST_TIME` [m, s].
STUCK_ADVANCE, TEST_TIME = 0.02, 1.5
# Time to come to rest, and how long it drives on after a proposal [s].
SETTLE_TIME, DRIVE_TIME = 0.8, 6.0
# A snake that has not got this far after so long will not get away [m, s].
HOPELESS_ADVANCE, HOPELESS_TIME = 0.03, 3.0
STEP = 0.05


@dataclass(frozen=True)
class RehearsedPlan:
    """Proposals after their rehearsals.

    Attributes:
        ranked: best first. faithful: whether the copy was as stuck as the robot; otherwise its word counts little.
        advance: of the copy while it should have been stuck [m].
    """

    ranked: tuple[RankedProposal, ...]
    faithful: bool
    advance: float


def copy_of(config: SnakeMovesConfig, world: World, X_WB: RigidTransform, joint_angles: np.ndarray) -> SnakeRun:
    """A robot without sensors in `world`, for rehearsals."""
    bare = replace(
        config, imu=None, pads=None, ranges=None, cameras=None, actuators=replace(config.actuators, faults=[])
    )
    return SnakeRun(make_snake_moves(bare, world, X_WB=X_WB, joint_angles=joint_angles, seed=0))


def settled_copy(config: SnakeMovesConfig, belief: Belief) -> SnakeRun:
    """A copy at rest in the state in which the robot is."""
    run = copy_of(config, belief.world, belief.X_WB, belief.joint_angles)
    run.give(Move(joints=tuple(float(q) for q in belief.joint_command)))
    run.advance(SETTLE_TIME)
    return run


def advance_of_copy(config: SnakeMovesConfig, belief: Belief) -> float:
    """How far the copy drives when its wheels turn as those of the stuck robot do [m]."""
    run = settled_copy(config, belief)
    start = run.head()
    run.give(Move(kind="wheels", speed=config.planner.speed))
    run.advance(TEST_TIME)
    return float(np.linalg.norm(run.head() - start))


def perform(run: SnakeRun, proposal: Proposal, watch: Callable[[], None]) -> tuple[float, str]:
    """Carries out a proposal; returns how long it took [s] and how it ended. `watch` is called every `STEP`."""
    start, reason = run.time, ""
    for planned, seconds in proposal.moves:
        move, until = run.give(planned), run.time + seconds
        while run.time < until - 1e-9:
            run.advance(STEP)
            watch()
            if move.kind == "recover":
                status = run.read("recovery.status")
                reason = status.reason
                if status.number == move.number and status.phase in ("done", "stopped", "refused"):
                    break
    return run.time - start, reason


def drive_on(
    run: SnakeRun, speed: float, seconds: float, watch: Callable[[], None], *, enough: float = np.inf
) -> float:
    """Drives on by shift control, while it gets anywhere and has not got far `enough` [m].

    Returns:
        How far the head got, seen from above [m].
    """
    start, begin, advance = run.head(), run.time, 0.0
    run.give(Move(kind="shift", speed=speed))
    for _ in range(round(seconds / STEP)):
        run.advance(STEP)
        watch()
        advance = float(np.linalg.norm((run.head() - start)[:2]))
        if advance >= enough or (advance < HOPELESS_ADVANCE and run.time - begin >= HOPELESS_TIME):
            break
    return advance


def rehearse(config: SnakeMovesConfig, belief: Belief, proposal: Proposal) -> Rehearsal:
    """Carries out `proposal` on a copy and drives on."""
    run = settled_copy(config, belief)
    tip_margin, joint_margin = np.inf, np.inf
    limits = np.array(config.snake.joint_limits())

    def watch() -> None:
        nonlocal tip_margin, joint_margin
        tip_margin = min(tip_margin, float(run.read("station.tip_margin")[0]))
        joint_margin = min(joint_margin, float(np.min(limits - np.abs(run.read("station.joint_angles")))))

    start = run.head()
    duration, reason = perform(run, proposal, watch)
    head_motion, error = float(np.linalg.norm(run.head() - start)), 0.0
    if proposal.name == "recover":
        error = float(np.linalg.norm(run.read("recovery.control_error")[:3]))
    safe = tip_margin
    advance = drive_on(run, config.planner.speed, DRIVE_TIME, watch)
    return Rehearsal(advance, head_motion, safe, joint_margin, error, duration, reason)


def plan(
    config: SnakeMovesConfig,
    belief: Belief,
    proposals: tuple[Proposal, ...],
    said: Callable[[Proposal, Rehearsal], None] = lambda proposal, result: None,
) -> RehearsedPlan:
    """Rehearses all proposals and ranks them; `said` hears of each."""
    advance = advance_of_copy(config, belief)
    rehearsed = []
    for proposal in proposals:
        result = rehearse(config, belief, proposal)
        said(proposal, result)
        rehearsed.append((proposal, result))
    ranked = rank(rehearsed, config.planner)
    faithful = advance < STUCK_ADVANCE
    if not faithful:  # a copy that is not stuck cannot say what would free it: recoveries first, as in doubt they work
        ranked = sorted(ranked, key=lambda item: (item.proposal.cheap, -item.score))
    return RehearsedPlan(tuple(ranked), faithful, advance)
