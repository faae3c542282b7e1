"""One drive over one ground, and the search for how steep, high and rough it may be."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from naraha.systems.config import quantity
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator

from .ability_worlds import GROUNDS, LENGTH
from .station import StationConfig, make_station
from .wiring import subsystem

# What a drive ended with.
PASSED, SLIPPED, TIPPED, HUNG = "passed", "slipped", "tipped", "hung"
# [rad] A base that leans this much more than the ground it is on has tipped over.
_TIPPED = 1.0
# [m] How far above the ground the station is built.
_ABOVE = 0.45
# [s] Time to settle on the ground before the drive begins.
_SETTLE = 0.5
# Of the way that the wheels have made, what a robot that hangs on its belly has not.
_HANGING = 0.3


@dataclass(kw_only=True)
class TrialConfig:
    """How the drives go, and how finely their levels are searched."""

    # [m/s] Speed of the drive.
    speed: float = quantity(0.3, unit="m/s", above=0)
    # [m] Way over the obstacle that counts as passed.
    way: float = quantity(2.0, unit="m", above=0, high=LENGTH - 1.0)
    # [-] A drive takes at most this many times as long as at full speed.
    patience: float = quantity(2.0, unit="-", above=1)
    # [m] A robot that drifts farther than this from its line on a side slope has slipped.
    drift: float = quantity(0.3, unit="m", above=0)
    # Drives at every level, each with its own start, heading and friction.
    drives: int = quantity(5, unit="drives", low=1)
    # [m], [deg] How far the start and the heading are off, at most.
    offset: float = quantity(0.1, unit="m", low=0)
    heading_deg: float = quantity(5.0, unit="deg", low=0)
    # [-] Lowest and highest friction between the robot and the ground.
    friction: list[float] = quantity([0.75, 0.95], unit="-", above=0, min_length=2)
    # [rad], [m] Highest level that is tried, by kind of ground.
    highest: dict[str, float] = field(
        default_factory=lambda: {"pitch_slope": 0.9, "roll_slope": 0.9, "step": 0.4, "ridges": 0.4}
    )
    # [-] The search ends when the interval is this small a part of the level, and after so many halvings.
    precision: float = quantity(0.05, unit="-", above=0)
    halvings: int = quantity(8, unit="halvings", low=1)


@dataclass(frozen=True)
class Interval:
    """Where a robot's ability ends for one kind of ground.

    Attributes:
        passes: highest level at which every drive passed; 0 when there is none.
        fails: lowest level above it at which one did not; infinite when all pass.
        reason: how it failed there.
        drives: number of drives that were made.
    """

    passes: float
    fails: float
    reason: str
    drives: int


def drive(station: StationConfig, kind: str, level: float, seed: int, config: TrialConfig) -> str:
    """Drives over a ground of `kind` at `level` once; returns how it ended.

    Start, heading and friction are drawn from `seed`. The robot drives straight ahead at constant speed, along x; on a
    side slope it starts on the slope. It has passed when its base is `way` behind the beginning of the obstacle.
    """
    rng = np.random.default_rng(seed)
    offset = config.offset * rng.uniform(-1, 1)
    heading = np.deg2rad(config.heading_deg) * rng.uniform(-1, 1)
    world = GROUNDS[kind](level, seed, float(rng.uniform(config.friction[0], config.friction[1])))
    height = station.robot.known_model().base_height
    # The station is built with the robot in the air: it must not start inside a slope.
    robot = replace(station.robot, start_xyz=[-1.0, 0.0, height + _ABOVE])
    diagram = make_station(replace(station, robot=robot), seed=seed, world=world)
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    plant = subsystem(diagram, "plant")
    ground = RigidTransform(RollPitchYaw(level if kind == "roll_slope" else 0.0, 0, 0), np.zeros(3))
    start = np.array([-1.0, offset, height])
    X_WB = ground @ RigidTransform(RollPitchYaw(0, 0, heading), start)
    base = plant.GetBodyByName("base", plant.GetModelInstanceByName("robot"))
    plant.SetFreeBodyPose(plant.GetMyMutableContextFromRoot(context), base, X_WB)
    command = diagram.GetInputPort("twist_command")
    command.FixValue(context, np.zeros(2))
    if diagram.HasInputPort("flipper_preset"):
        diagram.GetInputPort("flipper_preset").FixValue(context, "auto")
    simulator.AdvanceTo(_SETTLE)
    command.FixValue(context, np.array([config.speed, 0.0]))

    def read(port: str) -> Any:
        return diagram.GetOutputPort(port).Eval(context)

    driven_before = float(np.mean(read("track_displacements")))
    end = _SETTLE + config.patience * (1.0 + config.way) / config.speed
    furthest = -np.inf
    while context.get_time() < end:
        simulator.AdvanceTo(min(context.get_time() + 0.1, end))
        X_WB = read("cheat.X_WB")
        along, across, _ = (ground.inverse() @ X_WB).translation()
        furthest = max(furthest, along)
        lean = np.arccos(np.clip((ground.rotation().inverse() @ X_WB.rotation()).matrix()[2, 2], -1, 1))
        if lean > _TIPPED + (level if kind == "pitch_slope" else 0.0):
            return TIPPED
        if kind == "roll_slope" and abs(across - offset - np.tan(heading) * (along + 1.0)) > config.drift:
            return SLIPPED
        if along > config.way:
            return PASSED
    driven = float(np.mean(read("track_displacements"))) - driven_before
    return HUNG if furthest + 1.0 < (1 - _HANGING) * driven and kind in ("step", "ridges") else SLIPPED


def find_interval(passes: Callable[[float, int], str], highest: float, config: TrialConfig) -> Interval:
    """Searches where drives begin to fail, by halving between a level at which all pass and one at which some do not.

    Args:
        passes: how the drive at a level with a seed ended. highest: level that is tried first.
    """
    drives = 0

    def first_failure(level: float) -> str:
        nonlocal drives
        for seed in range(config.drives):
            drives += 1
            ended = passes(level, seed)
            if ended != PASSED:
                return ended
        return ""

    good, bad, reason = 0.0, highest, first_failure(highest)
    if not reason:
        return Interval(highest, float("inf"), "", drives)
    for _ in range(config.halvings):
        if bad - good <= config.precision * bad:
            break
        middle = 0.5 * (good + bad)
        failed = first_failure(middle)
        if failed:
            bad, reason = middle, failed
        else:
            good = middle
    return Interval(good, bad, reason, drives)
