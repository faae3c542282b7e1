"""`naraha traverse`: a robot drives to a goal over ground that it judges by its own ability."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
from naraha.systems.clouds import LocalCloud
from naraha.systems.files import replacing
from naraha.systems.sensing import write_tum
from naraha.systems.slam import Odometry6Dof
from naraha.systems.tracking import KanayamaConfig, KanayamaTracking
from naraha.systems.traversability import (
    Ability,
    FuzzyTraversability,
    FuzzyVfhController,
    PolarRiskHistogram,
    RiskMemory,
    TerrainFeatures,
)
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from .mission import Mission, Options
from .recording import start_meshcat, write_recording
from .robot_files import robot_ability
from .slam import add_matching
from .station import X_B, make_station
from .traverse_drawing import draw_traverse
from .traverse_log import TraverseLog
from .traverse_scenario import TraverseScenario, load_traverse
from .wiring import connect, export_outputs


def tracking_config(scenario: TraverseScenario, ability: Ability) -> KanayamaConfig:
    """The gains of the scenario, with the speeds and the limit of the ability unless the scenario has its own.

    K_x is chosen so that a sub-goal at the far edge of a rectangle, on ground without risk, gives the full speed.
    """
    if not scenario.tracking_from_ability:
        return scenario.tracking
    ahead = scenario.terrain.start + scenario.terrain.depth
    return replace(
        scenario.tracking,
        k_x=(1 - scenario.vfh.reference_share) * ability.max_speed / ahead,
        max_speed=ability.max_speed,
        max_yaw_rate=ability.max_yaw_rate,
        risk_limit=ability.risk_limit,
    )


def make_traverse(scenario: TraverseScenario, meshcat: Meshcat | None = None) -> Diagram:
    """Builds the drive: station → odometry → local cloud → features → τ → histogram → controller → tracking → station.

    The pose is that of the scan matching where there is one, else the odometry's; both begin where the scenario says
    that the robot stands. The local cloud is kept on it, too: where tracks slide, odometry is off by decimetres within
    the minute that points are remembered, and the matched pose jumps by centimetres.
    """
    builder = DiagramBuilder()
    ability = robot_ability(scenario.robot.model, scenario.ability)
    rectangles = scenario.terrain.rectangles

    station = make_station(scenario, seed=scenario.seed, meshcat=meshcat)
    builder.AddSystem(station)
    X_WB0 = scenario.robot.X_WB()
    odometry = builder.AddNamedSystem("odometry", Odometry6Dof(scenario.odometry, X_OB0=X_WB0))
    pose, X_MB = odometry, "X_OB"
    if scenario.matching is not None:
        X_BS = X_B(station, "lidar")
        pose = add_matching(builder, scenario.matching, station, odometry=odometry, X_BS=X_BS, X_MB0=X_WB0)
        X_MB = "X_MB"
    cloud_config = replace(scenario.local_cloud, base_height=float(X_WB0.translation()[2]))
    local_cloud = builder.AddNamedSystem("local_cloud", LocalCloud(cloud_config))
    terrain = builder.AddNamedSystem("terrain", TerrainFeatures(scenario.terrain))
    fuzzy = builder.AddNamedSystem("fuzzy", FuzzyTraversability(ability, rectangles))
    histogram = builder.AddNamedSystem("histogram", PolarRiskHistogram(ability, rectangles))
    controller = builder.AddNamedSystem("controller", FuzzyVfhController(ability, scenario.vfh))
    tracking = builder.AddNamedSystem("tracking", KanayamaTracking(tracking_config(scenario, ability)))
    goal = builder.AddNamedSystem("goal", ConstantVectorSource(np.array(scenario.goal, float)))

    connect(builder, station, "track_displacements", odometry)
    connect(builder, station, "rpy", odometry)
    connect(builder, station, "scan_S", local_cloud)
    connect(builder, station, "X_BS", local_cloud)
    connect(builder, pose, X_MB, local_cloud, "X_OB")
    connect(builder, local_cloud, "cloud_H", terrain)
    connect(builder, terrain, "features", fuzzy)
    connect(builder, terrain, "features", histogram)
    connect(builder, fuzzy, "traversability", histogram)
    connect(builder, histogram, "histogram", controller)
    connect(builder, pose, X_MB, controller, "X_MB")
    connect(builder, goal, "y0", controller, "goal")
    if scenario.memory is not None:
        memory = builder.AddNamedSystem("memory", RiskMemory(ability, scenario.memory))
        connect(builder, local_cloud, "cloud_H", memory)
        connect(builder, pose, X_MB, memory, "X_MB")
        connect(builder, memory, "risk_memory", controller)
    connect(builder, pose, X_MB, tracking, "X_MB")
    connect(builder, controller, "reference_pose", tracking)
    connect(builder, controller, "reference_twist", tracking)
    if tracking.HasInputPort("risk"):
        connect(builder, controller, "risk", tracking)
    connect(builder, tracking, "twist_command", station)
    connect(builder, tracking, "twist_command", controller)
    export_outputs(builder)
    diagram = builder.Build()
    diagram.set_name("traverse")
    return diagram


def write_drive(path: Path, log: TraverseLog) -> None:
    """Writes a line for every decision: time, true and estimated pose, command, risk and status."""
    with replacing(path) as temporary, temporary.open("w", newline="") as file:
        table = csv.writer(file)
        poses = [f"{frame}_{axis}" for frame in ("true", "believed") for axis in ("x_m", "y_m", "z_m", "heading_rad")]
        table.writerow(["time_s", *poses, "v_m_s", "omega_rad_s", "risk", "status"])
        for row in log.rows:
            table.writerow([f"{value:.4f}" if isinstance(value, float) else value for value in row])


def write_histograms(path: Path, log: TraverseLog) -> None:
    """Writes the histogram of every second: direction, risk and why it is not passable, a line for every rectangle."""
    with replacing(path) as temporary, temporary.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["time_s", "direction_rad", "risk", "reason"])
        for time, histogram, reasons in log.histograms:
            for direction, risk, reason in zip(histogram.directions, histogram.risk, reasons, strict=True):
                table.writerow([f"{time:.2f}", f"{direction:.4f}", f"{risk:.3f}", reason])


def traverse(scenario: TraverseScenario, options: Options) -> int:
    """Runs the mission, writes its products, and returns the exit code."""
    mission = Mission("traverse", scenario, options)
    meshcat = start_meshcat(scenario.recording, live=options.meshcat) if scenario.recording is not None else None
    diagram = make_traverse(scenario, meshcat)
    log = TraverseLog(scenario, robot_ability(scenario.robot.model, scenario.ability), diagram)
    ending = mission.simulate(
        Simulator(diagram),
        duration=scenario.duration,
        step=scenario.vfh.period,
        on_step=log.step,
        status_line=log.status_line,
    )
    ending = log.judged(ending)

    def write_metrics() -> None:
        mission.metrics.update(log.metrics())

    def write_tables() -> None:
        write_drive(mission.path("drive.csv"), log)
        write_histograms(mission.path("histograms.csv"), log)

    def write_trajectories() -> None:
        for name, file in ((log.believed, "trajectory.txt"), ("truth", "truth.txt")):
            write_tum(mission.path(file), log.trajectories[name].times, log.trajectories[name].matrices())

    def write_html() -> None:
        if meshcat is not None:
            draw_traverse(meshcat, log)
            write_recording(meshcat, mission.path("recording.html"))

    return mission.finish(ending, write_metrics, write_tables, write_trajectories, write_html)


__all__ = ["TraverseScenario", "load_traverse", "make_traverse", "tracking_config", "traverse"]
