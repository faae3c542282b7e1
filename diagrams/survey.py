"""`naraha survey`: the crawler drives a tour, scans, and maps what it drives through."""

import csv
from collections.abc import Sequence
from pathlib import Path

from naraha.systems.changes import ChangedObject, SurveyUpdate, read_survey, write_seen
from naraha.systems.display import SemanticDisplay
from naraha.systems.errors import ConfigError
from naraha.systems.files import replacing
from naraha.systems.hazards import SemanticMap
from naraha.systems.sensing import write_cloud, write_tum
from naraha.systems.slam import Odometry6Dof
from naraha.systems.tracking import KanayamaTracking, WaypointTour
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, System

from .fusion import add_detectors, add_fusion
from .mission import Ending, Mission, Options
from .operator import Operator, Prompt
from .recording import start_meshcat, write_recording
from .slam import add_maps, add_matching, slam_metrics, write_occupancy
from .station import X_B, make_station
from .survey_drawing import draw_survey
from .survey_log import SurveyLog
from .survey_loop import add_loop, add_loop_map
from .survey_scenario import SurveyScenario
from .wiring import connect, export_outputs


def make_survey(scenario: SurveyScenario, meshcat: Meshcat | None = None) -> Diagram:
    """Builds the survey: station → odometry → SLAM → fusion → maps → detectors, and tour or loop → tracking → station.

    The map frame M is the world frame W in so far as the robot's start is known: odometry and matching begin at the
    pose that the scenario states. Nothing else of the truth reaches them.
    """
    builder = DiagramBuilder()
    X_WB0 = scenario.robot.X_WB()
    check_flippers(scenario)

    station = make_station(scenario, seed=scenario.seed, meshcat=meshcat)
    builder.AddSystem(station)
    X_BS = X_B(station, "lidar")
    odometry = builder.AddNamedSystem("odometry", Odometry6Dof(scenario.odometry, X_OB0=X_WB0))
    slam = add_matching(builder, scenario, station, odometry=odometry, X_BS=X_BS, X_MB0=X_WB0)
    tracking = builder.AddNamedSystem("tracking", KanayamaTracking(scenario.tracking))

    connect(builder, station, "track_displacements", odometry)
    connect(builder, station, "rpy", odometry)
    mapped, fusion = slam, scenario.fusion
    if fusion is not None and scenario.head is not None:
        mapped = add_fusion(builder, fusion, scenario, station=station, odometry=odometry, slam=slam)
    survey_map = add_maps(builder, scenario, mapped, p_BS=X_BS.translation())
    map_source: tuple[System, str] = (survey_map, "map_M")
    if scenario.earlier:
        earlier = read_survey(scenario.earlier)
        update = SurveyUpdate(earlier, scenario.update, p_BS=X_BS.translation())
        map_source = (builder.AddNamedSystem("update", update), "updated_map_M")
        connect(builder, survey_map, "keyframes", update)
    if fusion is not None and scenario.head is not None:
        add_detectors(
            builder, fusion, scenario, station=station, slam=slam, survey_map=survey_map, map_source=map_source
        )
    connect(builder, slam, "X_MB", tracking)
    if scenario.loop is not None:
        if fusion is None or scenario.head is None:
            raise ConfigError(
                "a loop needs a semantic map", key="loop", valid="null, or a scenario with fusion and head"
            )
        loop_map = add_loop_map(
            builder,
            SemanticMap(fusion.semantic_map, X_BS=X_BS),
            survey_map=survey_map,
            map_source=map_source,
            period=scenario.loop.dose_period,
        )
        add_loop(
            builder,
            scenario.loop,
            model=scenario.robot.model,
            station=station,
            slam=slam,
            survey_map=survey_map,
            semantic_map=loop_map,
            tracking=tracking,
            meshcat=meshcat,
        )
    else:
        add_tour(builder, scenario, station=station, slam=slam, tracking=tracking)
    if meshcat is not None:
        display = builder.AddNamedSystem("display", SemanticDisplay(scenario.display, meshcat))
        connect(builder, mapped, "keyframe", display)
    export_outputs(builder)
    diagram = builder.Build()
    diagram.set_name("survey")
    return diagram


def add_tour(
    builder: DiagramBuilder, scenario: SurveyScenario, *, station: Diagram, slam: System, tracking: System
) -> None:
    """Adds `tour`, which leads `tracking` along the waypoints of the scenario."""
    tour = builder.AddNamedSystem("tour", WaypointTour(scenario.tour))
    connect(builder, slam, "X_MB", tour)
    connect(builder, tour, "reference_pose", tracking)
    connect(builder, tour, "reference_twist", tracking)
    connect(builder, tracking, "twist_command", station)
    if station.HasInputPort("flipper_preset"):
        connect(builder, tour, "flipper_preset", station)


def check_flippers(scenario: SurveyScenario) -> None:
    """Raises `ConfigError` for a waypoint whose flipper preset the driver does not have."""
    presets = ["auto", *getattr(scenario.robot.known_driver(), "flipper_presets", ())]
    for i, waypoint in enumerate(scenario.tour.waypoints):
        if waypoint.flippers not in presets:
            key = f"tour.waypoints[{i}].flippers"
            raise ConfigError("unknown flipper preset", key=key, value=waypoint.flippers, valid=presets)


def write_changes(path: Path, changes: Sequence[ChangedObject]) -> None:
    """Writes a line for every object: what became of it, centre and size of the box around it [m], how sure that is."""
    with replacing(path) as temporary, temporary.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["change", *(f"centre_{a}_m" for a in "xyz"), *(f"size_{a}_m" for a in "xyz"), "confidence"])
        for thing in changes:
            table.writerow([thing.kind, *(f"{v:.3f}" for v in (*thing.centre, *thing.extent, thing.confidence))])


def survey(scenario: SurveyScenario, options: Options) -> int:
    """Runs the mission, writes its products, and returns the exit code."""
    mission = Mission("survey", scenario, options)
    meshcat = start_meshcat(scenario.recording, live=options.meshcat) if scenario.recording is not None else None
    diagram = make_survey(scenario, meshcat)
    log, simulator = SurveyLog(scenario, diagram), Simulator(diagram)
    operator = Operator(diagram, simulator.get_mutable_context()) if scenario.loop is not None else None
    asks = scenario.loop is not None and scenario.loop.survey.operator == "prompt"
    prompt = Prompt(operator) if operator is not None and asks else None

    def on_step(context: Context) -> Ending | None:
        return log.step(context) or (prompt.step(context) if prompt is not None else None)

    ending = mission.simulate(
        simulator,
        duration=scenario.duration,
        step=scenario.slam.period,
        on_step=on_step,
        status_line=log.status_line,
        bar=prompt is None,
    )

    def write_metrics() -> None:
        mission.metrics.update(log.metrics())
        mission.metrics.update(slam_metrics(log))

    def write_semantic_metrics() -> None:
        mission.metrics.update(log.semantic_metrics())
        mission.metrics.update(log.change_metrics())

    def write_map() -> None:
        write_cloud(mission.path("survey_map.ply"), log.map_M())
        write_seen(mission.path("survey_seen.npz"), log.seen_space())
        write_occupancy(mission, log)
        if log.updated:
            write_changes(mission.path("changes.csv"), log.read("update.changes"))

    def write_trajectories() -> None:
        for name, file in (("estimate", "trajectory.txt"), ("odometry", "odometry.txt"), ("truth", "truth.txt")):
            write_tum(mission.path(file), log.trajectories[name].times, log.trajectories[name].matrices())

    def write_html() -> None:
        if meshcat is not None:
            write_recording(meshcat, mission.path("recording.html"), draw_survey(meshcat, log))

    return mission.finish(ending, write_metrics, write_semantic_metrics, write_map, write_trajectories, write_html)


__all__ = ["SurveyLog", "SurveyScenario", "make_survey", "survey"]
