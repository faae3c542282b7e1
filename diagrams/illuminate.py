"""`naraha illuminate`: routes and landmarks that evolve together, checked in physics, then the measuring run."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from matplotlib.figure import Figure
from naraha.models.plans import load_floor_plan
from naraha.models.worlds.halls import hang_lamps
from naraha.systems.config import quantity
from naraha.systems.errors import ScenarioError
from naraha.systems.placement import FloorPlan
from naraha.systems.sensing import IlluminanceField, fit_field, write_tum
from pydrake.geometry import Box, Cylinder, Meshcat, Rgba, Sphere
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from scipy.stats import norm

from .illuminate_drawing import (
    BELIEF,
    draw_errors,
    draw_hall,
    draw_illuminance,
    draw_placement,
    save_figure,
)
from .illuminate_drawing import TRUTH as TRUTH_COLOUR
from .illuminate_files import (
    map_points,
    write_landmarks,
    write_light,
    write_map,
    write_points,
    write_route,
    write_track,
)
from .illuminate_log import IlluminateLog, RunRecord
from .illuminate_planning import Planned, PlanningConfig, plan_measuring
from .illuminate_run import STEP
from .illuminate_station import MeasuringRoute, MeasuringRunConfig, make_illuminate, straight_route
from .mission import Ending, Mission, Options
from .recording import ESTIMATE, TRUTH, RecordingConfig, start_meshcat, write_recording
from .robot_files import robot_file
from .scenario import load_scenario


@dataclass(kw_only=True)
class IlluminateScenario(MeasuringRunConfig):
    """Everything that a measuring mission can vary."""

    description: str = ""
    # Seed of all noise, and of the evolution.
    seed: int = quantity(0, low=0)
    # A shipped floor plan, or a YAML file.
    plan: str = "construction_hall"
    # Null drives straight from point to point in the order of the plan, with the landmarks of `sites` put up.
    planning: PlanningConfig | None = field(default_factory=PlanningConfig)
    # [m] x, y of boxes that are put up where nothing is planned.
    sites: list[list[float]] = field(default_factory=list)
    # [m] A run has failed when the believed position is off by more than this; the paper's limit.
    slam_limit: float = quantity(0.4, unit="m", above=0)
    # [m] Every point must be measured within this; the paper's limit.
    position_limit: float = quantity(0.5, unit="m", above=0)
    # [m] Least distance from each other of what the illuminance map takes of the meter's readings on the way: points
    # that lie at alike places between lamps do not show how the light changes from one to the next.
    reading_spacing: float = quantity(2.0, unit="m", above=0)
    # [m] Grid of the illuminance map.
    map_spacing: float = quantity(0.5, unit="m", above=0)
    # Null leaves no recording.html.
    recording: RecordingConfig | None = field(default_factory=RecordingConfig)


def load_illuminate(name: str, settings: Sequence[str] = (), seed: int | None = None) -> IlluminateScenario:
    """Reads a scenario on what the robot brings along.

    Raises:
        ScenarioError, ConfigError: no such scenario or plan, or a value that cannot be used.
    """
    scenario = load_scenario(IlluminateScenario, name, settings, seed, base=robot_file("lux_robot"))
    for i, site in enumerate(scenario.sites):
        if len(site) != 2 or not np.isfinite(site).all():
            raise ScenarioError("not a place", where=name, key=f"sites[{i}]", value=site, valid="x, y [m]")
    planning, limit = scenario.planning, scenario.slam_limit
    if planning is not None and planning.slam_limit > limit:
        valid = f"at most slam_limit, {limit:g} m"
        key = "planning.slam_limit"
        raise ScenarioError("more than the run allows", where=name, key=key, value=planning.slam_limit, valid=valid)
    return scenario


def read_plan(scenario: IlluminateScenario) -> FloorPlan:
    """The floor plan that the scenario names. Raises `PlanError`, `ConfigError`."""
    return load_floor_plan(scenario.plan)


def illuminate(scenario: IlluminateScenario, options: Options) -> int:
    """Runs the mission, writes its products, and returns the exit code."""
    mission = Mission("illuminate", scenario, options)
    plan = read_plan(scenario)
    meshcat = start_meshcat(scenario.recording, live=options.meshcat) if scenario.recording is not None else None
    make_illuminate(scenario, plan, straight_route(plan), seed=scenario.seed)  # bad input shows before hours of work
    start = time.perf_counter()
    planned = _planned(scenario, plan, options)
    planning_time = time.perf_counter() - start
    diagram = make_illuminate(scenario, plan, planned.way, seed=scenario.seed, meshcat=meshcat)
    log = IlluminateLog(diagram, plan, planned.way, slam_limit=scenario.slam_limit)
    if planned.ending is None:
        ending = mission.simulate(
            Simulator(diagram),
            duration=scenario.duration,
            step=STEP,
            on_step=log.step,
            status_line=log.status_line,
        )
    else:
        ending = planned.ending
    record = log.record(ending) if log.context is not None else None
    ending = ending if record is None else judged(record, scenario.position_limit)

    def write_metrics() -> None:
        mission.metrics |= {} if record is None else record.metrics()
        mission.metrics |= planned.metrics() | {"planning_time_s": planning_time}

    def write_plan() -> None:
        write_route(mission.path("route.csv"), planned.way)
        write_landmarks(mission.path("landmarks.csv"), planned.way)
        planned.write(mission.path)

    products: list[Callable[[], None]] = [write_metrics, write_plan]
    if record is not None:
        products += run_products(mission, scenario, plan, planned, record, log.true_light, meshcat)
    return mission.finish(ending, *products)


def _planned(scenario: IlluminateScenario, plan: FloorPlan, options: Options) -> Planned:
    if scenario.planning is None:
        way = straight_route(plan)
        sites = np.array(scenario.sites, float).reshape(-1, 2)
        return Planned(MeasuringRoute(way.route, way.stops, way.points, sites))
    return plan_measuring(scenario.planning, scenario, plan, scenario.seed, console=options.console)


def judged(record: RunRecord, position_limit: float) -> Ending:
    """The ending, failed where a point was measured too far from where it was asked for [m]."""
    worst = max((p for p in record.points if p.measured is not None), key=lambda p: p.error, default=None)
    if record.succeeded and worst is not None and worst.error > position_limit:
        return Ending("failed", f"point {worst.point} was measured {worst.error:.2f} m from where it was asked for")
    return record.ending


def draw_run(
    meshcat: Meshcat, scenario: IlluminateScenario, plan: FloorPlan, way: MeasuringRoute, record: RunRecord
) -> None:
    """Draws lamps, windows, the planned route, where the robot was and believed to be, and what was measured where."""
    lamps = hang_lamps(plan, scenario.hall) if scenario.hall.lamps is None else scenario.hall.lamps
    for i, lamp in enumerate(lamps):
        meshcat.SetObject(f"lamps/{i}", Sphere(0.15), Rgba(1.0, 0.93, 0.6, 1.0))
        meshcat.SetTransform(f"lamps/{i}", RigidTransform(np.array(lamp.xyz)))
    for i, window in enumerate(scenario.hall.windows):
        meshcat.SetObject(f"windows/{i}", Box(0.02, *window.size), Rgba(0.6, 0.85, 1.0, 0.8))
        facing = RollPitchYaw(0, 0, np.deg2rad(window.yaw_deg))
        meshcat.SetTransform(f"windows/{i}", RigidTransform(facing, np.array(window.xyz)))
    lines = [("route", way.route, Rgba(0.2, 0.4, 0.9, 1.0), 0.02)]
    lines += [("truth", record.track[:, 1:3], TRUTH, 0.05), ("believed", record.track[:, 4:6], ESTIMATE, 0.06)]
    for name, points, colour, z in lines:
        if len(points) > 1:
            meshcat.SetLine(f"trajectory/{name}", np.column_stack([points, np.full(len(points), z)]).T, 3.0, colour)
    most = max((p.measured.illuminance for p in record.points if p.measured is not None), default=1.0)
    for p in record.points:
        share = 0.0 if p.measured is None else p.measured.illuminance / max(most, 1e-9)
        colour = Rgba(0.85, 0.1, 0.1, 1.0) if p.measured is None else Rgba(share, 0.85 * share, 0.2, 1.0)
        meshcat.SetObject(f"points/{p.point}", Cylinder(0.25, 0.02), colour)
        meshcat.SetTransform(f"points/{p.point}", RigidTransform(np.array([*p.asked, 0.02])))


def map_metrics(
    field: IlluminanceField, points: np.ndarray, true_light: Callable[[np.ndarray], np.ndarray]
) -> dict[str, float]:
    """What a map of the illuminance is worth at points (n, 2) [m], by the truth: the median error [lux], and the median
    of error over stated deviation, over the 0.674 that it has where errors are normal and as large as stated."""
    mean, deviation = field.at(points)
    error = np.abs(mean - true_light(points))
    ratio = np.median(error / deviation) / norm.ppf(0.75)
    return {"map_median_error_lux": float(np.median(error)), "map_error_over_stated": float(ratio)}


def run_products(
    mission: Mission,
    scenario: IlluminateScenario,
    plan: FloorPlan,
    planned: Planned,
    record: RunRecord,
    true_light: Callable[[np.ndarray], np.ndarray],
    meshcat: Meshcat | None,
) -> list[Callable[[], None]]:
    """What writes the products of a run that took place.

    Args:
        true_light: illuminance (n,) [lux] at places (n, 2) [m], which the map is judged by.
    """

    def write_tables() -> None:
        write_points(mission.path("points.csv"), record)
        write_track(mission.path("track.csv"), record)

    def write_run_picture() -> None:
        figure = Figure(figsize=(10, 10 * float(plan.size[1] / plan.size[0]) + 1.0), layout="constrained")
        axes = figure.subplots()
        failed_at = None if record.failed_at is None else np.array(record.failed_at)
        if planned.problem is None:
            draw_hall(axes, plan)
            axes.plot(*record.track[:, 1:3].T, color=TRUTH_COLOUR, lw=1, label="driven")
            axes.plot(*record.track[:, 4:6].T, color=BELIEF, lw=1, label="believed")
        else:
            draw_placement(axes, planned.problem, planned.best, track=record.track, failed_at=failed_at, links=False)
        figure.legend(loc="outside lower center", ncols=5, fontsize=8)
        save_figure(figure, mission.path("run.png"))
        if planned.problem is not None and planned.best is not None:
            save_figure(draw_errors(planned.problem, planned.best, record.track), mission.path("errors.png"))

    def write_trajectories() -> None:
        height = scenario.robot.known_model().base_height
        for file, columns in (("truth.txt", slice(1, 4)), ("trajectory.txt", slice(4, 7))):
            poses = [
                RigidTransform(RollPitchYaw(0, 0, heading), np.array([x, y, height])).GetAsMatrix4()
                for x, y, heading in record.track[:, columns].tolist()
            ]
            write_tum(mission.path(file), record.track[:, 0], np.array(poses))

    def write_illuminance_map() -> None:
        assert scenario.meter is not None  # without one no run is built
        where, values = record.light(scenario.meter.period, scenario.reading_spacing)
        if len(values) < 3:
            mission.options.console.print("too few points for a map of the illuminance", markup=False)
            return
        write_light(mission.path("light.csv"), where, values)
        field = fit_field(where, values, sight=plan.sight)
        write_map(mission.path("illuminance_map.csv"), plan, field, scenario.map_spacing)
        figure = draw_illuminance(plan, field, spacing=scenario.map_spacing, windows=scenario.hall.windows)
        save_figure(figure, mission.path("illuminance_map.png"))
        mission.metrics |= {"illuminance_mean_lux": field.mean, "illuminance_length_m": field.length}
        mission.metrics |= map_metrics(field, map_points(plan, scenario.map_spacing), true_light)

    def write_html() -> None:
        if meshcat is not None:
            draw_run(meshcat, scenario, plan, planned.way, record)
            write_recording(meshcat, mission.path("recording.html"))

    return [write_tables, write_trajectories, write_run_picture, write_illuminance_map, write_html]
