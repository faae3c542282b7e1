"""`naraha calibrate`: drives a robot over ever harder ground and writes down what it can do."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from naraha.models.worlds import World
from naraha.systems.config import quantity
from naraha.systems.files import replacing
from naraha.systems.routes import Primitives
from naraha.systems.traversability import (
    Ability,
    FuzzyConfig,
    SizeTerms,
    TerrainConfig,
    describe_terrain,
    write_ability,
)
from rich.progress import Progress, TextColumn

from .ability_trials import Interval, TrialConfig, drive, find_interval
from .ability_worlds import GROUNDS, LENGTH
from .mission import Ending, Mission, Options, stop_flag
from .primitive_trials import PrimitiveTrials
from .robot_files import has_primitives, robot_file, robot_primitives
from .scenario import load_scenario
from .station import StationConfig

# Corners of SMALL, MEDIUM and LARGE as parts of the highest level at which every drive passed.
_CORNERS = (0.4, 0.55, 0.75, 1.0)
# What is found out, and its unit; of the grounds that there are, these.
_UNITS = {"pitch_slope": "rad", "roll_slope": "rad", "step": "m", "ridges": "m"}
# The limit of roughness is at least this many times what noise makes of flat ground.
_LEAST_ROUGHNESS = 4.0
# [m] A step that noise may make is none.
_LEAST_STEP = 0.03
# Points a square metre, and their noise [m], in which roughness is measured as a robot would.
_DENSITY, _NOISE = 2000, 0.01


@dataclass(kw_only=True)
class CalibrateScenario(StationConfig):
    """A robot, and how it is tried."""

    description: str = ""
    # Seed of starts, headings, friction and ridges.
    seed: int = quantity(0, low=0)
    trials: TrialConfig = field(default_factory=TrialConfig)
    # How the motions of route learning are tried (`--kind primitives`).
    primitives: PrimitiveTrials = field(default_factory=PrimitiveTrials)
    # Rectangles in which the robot will look at the ground.
    terrain: TerrainConfig = field(default_factory=TerrainConfig)
    # What is not found by driving: footprint, speeds, coverage and risk limit. What is, is replaced.
    given: Ability = field(default_factory=Ability)


def load_calibrate(robot: str, settings: Sequence[str] = (), seed: int | None = None) -> CalibrateScenario:
    """The calibration of one of the robots, without its sensors. Raises `ScenarioError`, `ConfigError`."""
    scenario = load_scenario(CalibrateScenario, "calibrate", settings, seed, base=robot_file(robot))
    scenario.lidar = scenario.head = scenario.tilt = None
    return scenario


def terms(limit: float, digits: int) -> SizeTerms:
    """SMALL, MEDIUM and LARGE of a feature that a robot copes with up to `limit`: from there on it is LARGE alone."""
    a, b, c, d = (round(corner * limit, digits) for corner in _CORNERS)
    return SizeTerms(small=[0.0, 0.0, a, b], medium=[a, b, c, d], large=[c, d, d, d])


def ability_from(intervals: dict[str, Interval], roughness: float, scenario: CalibrateScenario) -> Ability:
    """The ability that follows from what was passed.

    Memberships from the limits of slopes and roughness; the step as it is, but no less than the noise of the heights,
    and then its own limit beside it.
    A rectangle is too high when its middle is higher than the steepest slope and the highest step together can make
    it. At a risk limit of 60, one feature alone is passable up to 0.95 of its limit. How far turns slide follows from
    the motions of route learning, where those were measured before.

    Args:
        roughness: limit of it [m²].
    """
    model = scenario.robot.model
    pitch, roll, step = (intervals[kind].passes for kind in ("pitch_slope", "roll_slope", "step"))
    fuzzy = FuzzyConfig(pitch_slope=terms(pitch, 4), roll_slope=terms(roll, 4), roughness=terms(roughness, 7))
    middle = scenario.terrain.start + 0.5 * scenario.terrain.depth
    return replace(
        scenario.given,
        robot=model,
        source=(
            f"slopes, roughness, step and height measured by naraha calibrate --robot {model} "
            f"--seed {scenario.seed}, turn_slide by --kind primitives, if at all; the rest is given in station.yaml"
        ),
        fuzzy=fuzzy,
        height_threshold=round(middle * float(np.tan(pitch)) + step, 3),
        step_threshold=round(max(step, _LEAST_STEP), 4),
        step_limit=round(step, 4) if step < _LEAST_STEP else None,
        turn_slide=turn_slide(robot_primitives(model)) if has_primitives(model) else scenario.given.turn_slide,
    )


def turn_slide(primitives: Primitives) -> float:
    """How far turns on the spot slid downhill on the slope, up and down, see `Ability.turn_slide` [m/rad]; to one
    decimal, since turns to the left and right and up and down differ in the second."""
    slides = [
        abs(outcome.mean[0]) / (abs(outcome.mean[2]) * np.sin(ground.level))
        for ground in (primitives.grounds[name] for name in ("slope_up", "slope_down"))
        for outcome in (ground.motions["left"], ground.motions["right"])
    ]
    return round(float(np.mean(slides)), 1)


def measured_roughness(height: float, seed: int, config: TerrainConfig) -> float:
    """Median roughness that the rectangles see on ridges of a height [m], from points as a LiDAR gives them [m²]."""
    world = GROUNDS["ridges"](max(height, 1e-6), seed, 0.9)
    points = surface_points(world, seed)
    found = []
    for x in np.arange(0.0, LENGTH - config.start - config.depth, 0.25):
        table = describe_terrain(points - np.array([x, 0, 0], np.float32), replace(config, rectangles=1))
        found.append(float(table.roughness[0]))
    return float(np.median(found))


def surface_points(world: World, seed: int) -> np.ndarray:
    """Points (N, 3) float32 all over the ground ahead of x = 0, from rays straight down."""
    rng = np.random.default_rng(seed)
    count = int(_DENSITY * LENGTH * 2)
    start = np.column_stack([rng.uniform(0, LENGTH, count), rng.uniform(-1, 1, count), np.full(count, 3.0)])
    down = np.tile([0.0, 0.0, -1.0], (count, 1))
    hits = world.ray_scene().cast(start.astype(np.float32), down.astype(np.float32))
    z = 3.0 - hits.distance + rng.normal(0, _NOISE, count)
    return np.column_stack([start[:, :2], z])[np.isfinite(z)].astype(np.float32)


def drives_bar(options: Options) -> Progress:
    """What is driven now, on a terminal."""
    return Progress(
        TextColumn("[bold]calibrate[/] {task.description}"),
        console=options.console,
        transient=True,
        disable=not options.console.is_terminal,
    )


def calibrate(scenario: CalibrateScenario, options: Options) -> int:
    """Runs the mission, writes `ability.yaml` and `trials.csv`, and returns the exit code."""
    mission = Mission("calibrate", scenario, options)
    intervals: dict[str, Interval] = {}
    rows: list[list[object]] = []
    ending = Ending("done", "every kind of ground was tried")
    bar = drives_bar(options)
    with mission.timed(), bar, stop_flag() as stopped:
        task = bar.add_task("")
        try:
            for kind in _UNITS:

                def passes(level: float, seed: int, kind: str = kind) -> str:
                    if stopped():
                        raise KeyboardInterrupt
                    bar.update(task, description=f"{kind} {level:.4g} {_UNITS[kind]}, drive {seed + 1}")
                    ended = drive(scenario, kind, level, scenario.seed * 1000 + seed, scenario.trials)
                    rows.append([kind, level, seed, ended])
                    return ended

                intervals[kind] = find_interval(passes, scenario.trials.highest[kind], scenario.trials)
        except KeyboardInterrupt:
            ending = Ending("interrupted", f"interrupted after {len(rows)} drives")

    def write_trials() -> None:
        with replacing(mission.path("trials.csv")) as temporary, temporary.open("w", newline="") as file:
            table = csv.writer(file)
            table.writerow(["kind", "level", "drive", "ended"])
            table.writerows(rows)

    def write_metrics() -> None:
        for kind, interval in intervals.items():
            unit = _UNITS[kind]
            mission.metrics[f"{kind}_passes_{unit}"] = interval.passes
            mission.metrics[f"{kind}_fails_{unit}"] = interval.fails
            mission.metrics[f"{kind}_fails_by"] = interval.reason
            if unit == "rad":
                mission.metrics[f"{kind}_passes_deg"] = float(np.rad2deg(interval.passes))
                mission.metrics[f"{kind}_fails_deg"] = float(np.rad2deg(interval.fails))
        mission.metrics["drives"] = len(rows)

    def write_file() -> None:
        if len(intervals) == len(_UNITS):
            flat, rough = (
                measured_roughness(top, scenario.seed, scenario.terrain) for top in (0.0, intervals["ridges"].passes)
            )
            mission.metrics |= {"roughness_flat_m2": flat, "roughness_passes_m2": rough}
            limit = max(rough, _LEAST_ROUGHNESS * flat)
            write_ability(mission.path("ability.yaml"), ability_from(intervals, limit, scenario))

    return mission.finish(ending, write_trials, write_metrics, write_file)
