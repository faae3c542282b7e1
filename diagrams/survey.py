"""`naraha survey`: the crawler drives a tour, scans, and maps what it drives through."""

from dataclasses import dataclass, field

import numpy as np
from naraha.systems.config import quantity
from naraha.systems.display import KeyframeDisplay, KeyframeDisplayConfig
from naraha.systems.errors import ConfigError
from naraha.systems.sensing import RayScene, write_cloud, write_tum
from naraha.systems.slam import (
    Keyframe,
    Odometry6Dof,
    OdometryConfig,
    ScanMatcher,
    ScanMatcherConfig,
    SurveyMap,
    SurveyMapConfig,
    map_error,
    rebuild_map,
    trajectory_error,
)
from naraha.systems.tracking import KanayamaConfig, KanayamaTracking, TourConfig, WaypointTour
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from .mission import Ending, Mission, Options
from .recording import (
    BASELINE,
    ESTIMATE,
    ODOMETRY,
    TRUTH,
    RecordingConfig,
    draw_trajectory,
    start_meshcat,
    write_recording,
)
from .station import X_BS, StationConfig, make_station, station_world
from .trajectory import Trajectory
from .wiring import DiagramReader, connect, export_outputs, subsystem


@dataclass(kw_only=True)
class SurveyScenario(StationConfig):
    """Everything that a survey can vary."""

    description: str = ""
    # Seed of all noise, and of the world unless that has its own.
    seed: int = quantity(0, low=0)
    # The survey ends at the latest after this simulated time [s].
    duration: float = quantity(600.0, unit="s", above=0)
    # The survey fails when no waypoint is reached for this long [s]: the robot is stuck.
    patience: float = quantity(90.0, unit="s", above=0)
    # The survey fails when the robot is tilted more than this [rad].
    tip_over_angle: float = quantity(1.2, unit="rad", above=0)
    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    # Registration that steers the robot and makes the map.
    slam: ScanMatcherConfig = field(default_factory=ScanMatcherConfig)
    # A second registration, for comparison only; null saves its time.
    baseline: ScanMatcherConfig | None = None
    survey_map: SurveyMapConfig = field(default_factory=SurveyMapConfig)
    tour: TourConfig = field(default_factory=TourConfig)
    tracking: KanayamaConfig = field(default_factory=KanayamaConfig)
    display: KeyframeDisplayConfig = field(default_factory=KeyframeDisplayConfig)
    # Null leaves no recording.html.
    recording: RecordingConfig | None = field(default_factory=RecordingConfig)


def make_survey(scenario: SurveyScenario, meshcat: Meshcat | None = None) -> Diagram:
    """Builds the survey: station → odometry → scan matching → map, and tour → tracking → station.

    The map frame M is the world frame W in so far as the robot's start is known: odometry and matching begin at the
    pose that the scenario states. Nothing else of the truth reaches them.
    """
    builder = DiagramBuilder()
    X_WB0 = scenario.robot.X_WB()
    check_flippers(scenario)

    station = builder.AddSystem(make_station(scenario, seed=scenario.seed, meshcat=meshcat))
    odometry = builder.AddNamedSystem("odometry", Odometry6Dof(scenario.odometry, X_OB0=X_WB0))
    slam = builder.AddNamedSystem("slam", ScanMatcher(scenario.slam, X_BS=X_BS(station), X_MB0=X_WB0))
    survey_map = builder.AddNamedSystem("survey_map", SurveyMap(scenario.survey_map))
    tour = builder.AddNamedSystem("tour", WaypointTour(scenario.tour))
    tracking = builder.AddNamedSystem("tracking", KanayamaTracking(scenario.tracking))

    connect(builder, station, "track_displacements", odometry)
    connect(builder, station, "rpy", odometry)
    connect(builder, station, "scan_S", slam)
    connect(builder, odometry, "X_OB", slam)
    connect(builder, slam, "keyframe", survey_map)
    connect(builder, slam, "X_MB", tour)
    connect(builder, slam, "X_MB", tracking)
    connect(builder, tour, "reference_pose", tracking)
    connect(builder, tour, "reference_twist", tracking)
    connect(builder, tracking, "twist_command", station)
    connect(builder, tour, "flipper_preset", station)
    if scenario.baseline is not None:
        baseline = builder.AddNamedSystem("baseline", ScanMatcher(scenario.baseline, X_BS=X_BS(station), X_MB0=X_WB0))
        connect(builder, station, "scan_S", baseline)
        connect(builder, odometry, "X_OB", baseline)
    if meshcat is not None:
        display = builder.AddNamedSystem("display", KeyframeDisplay(scenario.display, meshcat))
        connect(builder, slam, "keyframe", display)
    export_outputs(builder)
    diagram = builder.Build()
    diagram.set_name("survey")
    return diagram


def check_flippers(scenario: SurveyScenario) -> None:
    """Raises `ConfigError` for a waypoint whose flipper preset the driver does not have."""
    presets = ["auto", *scenario.robot.driver.flipper_presets]
    for i, waypoint in enumerate(scenario.tour.waypoints):
        if waypoint.flippers not in presets:
            key = f"tour.waypoints[{i}].flippers"
            raise ConfigError("unknown flipper preset", key=key, value=waypoint.flippers, valid=presets)


class SurveyLog(DiagramReader):
    """What a survey's metrics and products are made of, read from the running diagram at every step."""

    def __init__(self, scenario: SurveyScenario, diagram: Diagram):
        super().__init__(diagram)
        self._scenario = scenario
        sources = {
            "truth": "station.cheat.X_WB",
            "estimate": "slam.X_MB",
            "odometry": "odometry.X_OB",
            "baseline": "baseline.X_MB",
        }
        self._sources = {name: port for name, port in sources.items() if diagram.HasOutputPort(port)}
        self.trajectories = {name: Trajectory() for name in self._sources}
        self._last_waypoint = (0.0, 0.0)

    def step(self, context: Context) -> Ending | None:
        """Appends the poses of now, and says whether the survey is over."""
        self.context, time = context, context.get_time()
        for name, port in self._sources.items():
            self.trajectories[name].append(time, self.read(port))
        reached = float(self.read("tour.waypoints_reached")[0])
        if reached > self._last_waypoint[0]:
            self._last_waypoint = (reached, time)
        rpy = self.read("station.rpy")
        count = len(self._scenario.tour.waypoints)
        if self.read("tour.done")[0] > 0:
            return Ending("done", f"all {count} waypoints are reached")
        if np.cos(rpy[0]) * np.cos(rpy[1]) < np.cos(self._scenario.tip_over_angle):
            return Ending("failed", f"the robot tipped over at {time:.1f} s")
        if time - self._last_waypoint[1] > self._scenario.patience:
            return Ending("failed", f"stuck on the way to waypoint {int(reached) + 1} of {count} since {time:.0f} s")
        return None

    def status_line(self, context: Context) -> str:
        health = self.read("slam.health")
        return f"waypoint {int(self.read('tour.waypoints_reached')[0]) + 1}, {health.scans_used} keyframes"

    def keyframes(self) -> tuple[Keyframe, ...]:
        return self.read("survey_map.keyframes")

    def metrics(self) -> dict[str, float]:
        """Errors against the truth of all trajectories and of the maps that are built on them (row S0-g)."""
        scenario, truth, keyframes = self._scenario, self.trajectories["truth"], self.keyframes()
        health = self.read("slam.health")
        metrics: dict[str, float] = {
            "waypoints": len(scenario.tour.waypoints),
            "waypoints_reached": int(self._last_waypoint[0]),
            "path_length_m": truth.length(),
            "scans": int(self.read("station.scan_S").index) + 1 if scenario.lidar is not None else 0,
            "keyframes": len(keyframes),
            "scans_skipped": health.scans_skipped,
        }
        voxel = scenario.survey_map.voxel_size
        times = [keyframe.time for keyframe in keyframes]
        true_map = rebuild_map(keyframes, [truth.at(t) for t in times], voxel)
        surfaces = self._true_surfaces()
        for prefix, name in (("", "estimate"), ("odometry_", "odometry"), ("baseline_", "baseline")):
            if name not in self.trajectories:
                continue
            trajectory = self.trajectories[name]
            mean, largest = trajectory_error(
                trajectory.times, trajectory.matrices(), truth.times, truth.matrices(), align="none"
            )
            metrics[f"{prefix}trajectory_error_mean_m"] = mean
            metrics[f"{prefix}trajectory_error_max_m"] = largest
            if keyframes:
                poses = [k.X_MB for k in keyframes] if name == "estimate" else [trajectory.at(t) for t in times]
                points = rebuild_map(keyframes, poses, voxel).point.positions.numpy()
                metrics[f"{prefix}map_error_m"] = map_error(points, true_map.point.positions.numpy())
                metrics[f"{prefix}map_surface_error_m"] = float(surfaces.distance_to_surface(points).mean())
        return metrics

    def _true_surfaces(self) -> RayScene:
        inspector = subsystem(self.diagram, "station", "scene_graph").model_inspector()
        return RayScene(inspector, station_world(self._scenario, self._scenario.seed).surface_table(), threads=0)


def survey(scenario: SurveyScenario, options: Options) -> int:
    """Runs the mission, writes its products, and returns the exit code."""
    mission = Mission("survey", scenario, options)
    meshcat = start_meshcat(scenario.recording, live=options.meshcat) if scenario.recording is not None else None
    diagram = make_survey(scenario, meshcat)
    log = SurveyLog(scenario, diagram)
    ending = mission.simulate(
        Simulator(diagram),
        duration=scenario.duration,
        step=scenario.slam.period,
        on_step=log.step,
        status_line=log.status_line,
    )

    def write_metrics() -> None:
        mission.metrics.update(log.metrics())

    def write_map() -> None:
        write_cloud(mission.path("survey_map.ply"), log.read("survey_map.map_M"))

    def write_trajectories() -> None:
        for name, file in (("estimate", "trajectory.txt"), ("odometry", "odometry.txt"), ("truth", "truth.txt")):
            write_tum(mission.path(file), log.trajectories[name].times, log.trajectories[name].matrices())

    def write_html() -> None:
        if meshcat is not None:
            colours = {"truth": TRUTH, "estimate": ESTIMATE, "odometry": ODOMETRY, "baseline": BASELINE}
            for name, trajectory in log.trajectories.items():
                draw_trajectory(meshcat, name, trajectory, colours[name])
            write_recording(meshcat, mission.path("recording.html"))

    return mission.finish(ending, write_metrics, write_map, write_trajectories, write_html)


__all__ = ["SurveyLog", "SurveyScenario", "make_survey", "survey"]
