"""What each part of null-space recovery is worth, and what an operator's cheap moves do, case by case.

In the stuck worlds: one move at the true unit, then driving on. Where single terms of the cost matter: recoveries on
given postures, since in the stuck worlds the target above the segment leads away from the singular straight pose by
itself, and the end of a range never comes near.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from naraha.diagrams.recover import RecoverScenario
from naraha.diagrams.snake_moves import SnakeRun, snake_body
from naraha.diagrams.snake_rehearsal import copy_of, drive_on, perform
from naraha.models.worlds import World, surfaces
from naraha.models.worlds.stuck import stuck_case
from naraha.models.worlds.world import Solid
from naraha.systems.snake import (
    NullSpaceConfig,
    RecoveryCommand,
    SnakeBody,
    idle_run,
    middle_in_head,
    preset,
    start_run,
    step_run,
)
from naraha.systems.snake.recovery_planner import Proposal, cheap_moves, recover_moves
from naraha.systems.snake.snake_pilot import Move
from pydrake.math import RigidTransform, RollPitchYaw

SPEED, FREE, DRIVE_TIME = 0.1, 0.5, 7.0
"""[m/s], [m], [s] Free means that it drives on so far in so long."""

METHODS: dict[str, dict[str, object] | None] = {
    "recovery": {},
    "no_null_space": {"alpha": 0.0},
    "no_manipulability": {"singular_weight": 0.0},
    "no_joint_term": {"joint_weight": 0.0},
    "paper_weights": None,
    "no_shift": {"trailing": "hold"},
}
"""What is changed of the recovery in every ablation; None is the preset of the paper."""

UNBOUNDED: dict[str, dict[str, object] | None] = {
    "unbounded": {"bounded": False},
    "unbounded_no_joint_term": {"bounded": False, "joint_weight": 0.0},
    "unbounded_joint_weight_1": {"bounded": False, "joint_weight": 1.0},
}
"""The law as published has no hard bounds on joints: there the joint term is all that keeps them in their range."""

CHEAP = ("drive_on", "shift", "relax", "reverse", "torque")
"""What an operator would try first. After every move the snake drives on by shift control; the first does only that."""

DRIVE_ON = Proposal("drive_on", (), True)


@dataclass(frozen=True)
class Outcome:
    """How one attempt went: freed or done, time [s], worst head motion and control error [m], smallest margins."""

    ok: bool
    time: float
    head: float = 0.0
    control: float = np.nan
    joints: float = np.inf
    tip: float = np.inf
    manipulability: float = np.nan


def method(name: str) -> NullSpaceConfig:
    """The configuration of one of `METHODS` or `UNBOUNDED`."""
    changes = (METHODS | UNBOUNDED)[name]
    return preset("paper") if changes is None else replace(NullSpaceConfig(), **changes)  # type: ignore[arg-type]


class _Watch:
    """Worst values while a snake moves."""

    def __init__(self, run: SnakeRun, limits: np.ndarray):
        self.run, self.limits, self.start = run, limits, run.head()
        self.head, self.control, self.joints, self.tip = 0.0, np.nan, np.inf, np.inf

    def __call__(self) -> None:
        run = self.run
        self.head = max(self.head, float(np.linalg.norm(run.head() - self.start)))
        self.joints = min(self.joints, float(np.min(self.limits - np.abs(run.read("station.joint_angles")))))
        self.tip = min(self.tip, float(run.read("station.tip_margin")[0]))
        status = run.read("recovery.status")
        if status.phase in ("moving", "settling", "done"):
            self.control = float(np.fmax(self.control, np.linalg.norm(status.control_error[:3])))


def in_stuck_world(kind: int, seed: int, name: str) -> Outcome:
    """Carries out one move at the true unit of a case, without sensors and planner, and drives on."""
    scenario = RecoverScenario(stuck=kind, seed=seed, recording=None)
    case = stuck_case(kind, seed, snake=scenario.snake)
    scenario = scenario if name in CHEAP else replace(scenario, recovery=method(name))
    run = copy_of(scenario, case.world, case.X_WB, case.joint_angles)
    run.give(Move(joints=tuple(float(q) for q in case.joint_command)))
    run.advance(1.2)
    run.give(Move(kind="wheels", speed=SPEED))
    run.advance(1.5)
    run.give(Move())
    run.advance(0.3)
    if name in CHEAP:
        proposal = next(p for p in (DRIVE_ON, *cheap_moves(scenario.planner)) if p.name == name)
    else:
        rpy = RollPitchYaw(run.read("station.cheat.X_WB").rotation()).vector()
        angles = run.read("station.joint_angles")
        proposal = recover_moves(case.unit, angles, rpy, snake_body(scenario), scenario.planner)[0]
    watch = _Watch(run, np.array(scenario.snake.joint_limits()))
    seconds, _ = perform(run, proposal, watch)
    advance = drive_on(run, SPEED, DRIVE_TIME, lambda: None, enough=FREE)
    return Outcome(advance >= FREE, seconds, watch.head, watch.control, watch.joints, watch.tip)


Posture = tuple[np.ndarray, RecoveryCommand]


def straight_ahead(seed: int, body: SnakeBody) -> Posture:
    """Near a singular pose: a segment that is straight but for 0.3°, its target straight ahead and not above it."""
    rng = np.random.default_rng([seed, 1])
    angles = 0.005 * rng.standard_normal(len(body.joint_limits))
    return _towards(angles, np.array([body.half_length, 0.0, 0.0]), body)


def near_limits(seed: int, body: SnakeBody) -> Posture:
    """Near the ends of ranges: a bent segment, one yaw joint 4° before the end of its range, the target to its side."""
    rng = np.random.default_rng([seed, 2])
    angles = np.zeros(len(body.joint_limits))
    angles[7:16:2] = np.clip(0.3 * rng.standard_normal(5), -0.8, 0.8)
    joint = int(rng.choice([7, 9, 11, 13]))
    side = rng.choice([-1.0, 1.0])
    angles[joint] = side * (body.joint_limits[joint] - np.deg2rad(4))
    offset = np.array([body.half_length, side * rng.uniform(0.05, 0.2), rng.uniform(0.1, 0.25)])
    return _towards(angles, offset, body)


POSTURES: dict[str, Callable[[int, SnakeBody], Posture]] = {
    "straight_ahead": straight_ahead,
    "near_limits": near_limits,
}


def _towards(angles: np.ndarray, offset: np.ndarray, body: SnakeBody) -> Posture:
    x, y, z = (float(v) for v in middle_in_head(angles, 3, 7, body.half_length) + offset)
    return angles, RecoveryCommand(1, True, 3, 7, (x, y, z))


def in_kinematics(family: str, seed: int, name: str, follow: float = 0.5) -> Outcome:
    """A recovery of joints that follow their commands by the share `follow` in every tick, nothing else."""
    body, config = snake_body(RecoverScenario()), method(name)
    angles, command = POSTURES[family](seed, body)
    run = start_run(idle_run(body), command, angles, body, config)
    control, joints, manipulability, ticks = 0.0, np.inf, np.inf, 0
    while run.status.phase in ("moving", "settling") and ticks < 2500:
        run, ticks = step_run(run, angles, np.inf, body, config), ticks + 1
        if np.isfinite(run.status.distance):
            control = max(control, float(np.linalg.norm(run.status.control_error[:3])))
            joints = min(joints, run.status.joint_margin)
            manipulability = min(manipulability, run.status.manipulability)
        angles = angles + follow * (run.joints - angles)
    done, seconds = run.status.phase == "done", ticks * config.period
    return Outcome(done, seconds, control=control, joints=joints, manipulability=manipulability)


def in_physics(family: str, seed: int, name: str) -> Outcome:
    """The same recovery of a snake that lies on flat ground."""
    scenario = replace(RecoverScenario(recording=None), recovery=method(name))
    body = snake_body(scenario)
    angles, command = POSTURES[family](seed, body)
    floor = Solid(name="floor", box=[8, 8, 0.2], xyz=[0, 0, -0.1], surface="floor", friction=0.8)
    world = World(solids=[floor], surfaces={"floor": surfaces.CONCRETE_FLOOR})
    start = RigidTransform(np.array([0.0, 0.0, body.wheel_radius + 0.002]))
    run = copy_of(scenario, world, start, angles)
    run.give(Move(joints=tuple(float(q) for q in angles)))
    run.advance(0.8)
    watch = _Watch(run, np.array(scenario.snake.joint_limits()))
    proposal = Proposal("recover", ((Move(kind="recover", recovery=command), 12.0),), False)
    seconds, _ = perform(run, proposal, watch)
    status = run.read("recovery.status")
    return Outcome(status.phase == "done", seconds, watch.head, watch.control, watch.joints, watch.tip)
