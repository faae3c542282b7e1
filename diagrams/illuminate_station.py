"""The measuring run of `naraha illuminate` as one diagram: the robot in its hall, localisation, behaviours, tour."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from naraha.models import MODELS_DIR
from naraha.models.worlds.halls import HallConfig, build_hall
from naraha.systems.behaviors import (
    BehaviorCoordinator,
    FuzzyGoalSeeking,
    FuzzyObstacleAvoidance,
    MeasuringTour,
    MeasuringTourConfig,
    read_behaviors,
)
from naraha.systems.config import quantity
from naraha.systems.errors import ConfigError, ScenarioError
from naraha.systems.localization import EvolutionLocalizer, LaserRing, LocalizerConfig, OccupancyGrid
from naraha.systems.placement import FloorPlan
from naraha.systems.sensing import IlluminanceMeterConfig, Lidar
from naraha.systems.slam import Odometry6Dof, OdometryConfig
from naraha.systems.tracking import planar_pose
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Diagram, DiagramBuilder

from .robots import RobotConfig
from .seeds import sensor_seed
from .station import X_B, StationConfig, make_station
from .wiring import connect, export_outputs, subsystem


@dataclass(kw_only=True)
class MeasuringRunConfig(StationConfig):
    """What a measuring run can vary, apart from where it goes and what was put up for it."""

    robot: RobotConfig = field(default_factory=lambda: RobotConfig(model="lux_robot"))
    meter: IlluminanceMeterConfig | None = field(default_factory=IlluminanceMeterConfig)
    # Boxes, lamps and windows of the hall.
    hall: HallConfig = field(default_factory=HallConfig)
    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    localizer: LocalizerConfig = field(default_factory=LocalizerConfig)
    # [s] between two scans that the localiser takes; in between the pose goes on with odometry.
    localizer_period: float = quantity(0.2, unit="s", above=0)
    # Whether the localiser is given the plan with the added landmarks; without, its map is empty at the start.
    map_from_plan: bool = True
    # How the robot drives: the name of a file beside its model, or a YAML file.
    behaviors: str = "behaviors"
    tour: MeasuringTourConfig = field(default_factory=MeasuringTourConfig)
    # [s] A run that takes longer than this simulated time has failed.
    duration: float = quantity(1500.0, unit="s", above=0)


@dataclass(frozen=True, eq=False)
class MeasuringRoute:
    """Where a measuring run goes. Read-only.

    Attributes:
        route: (p, 2) points to drive to, in order, in W [m].
        stops: (n,) which of them are measured at.
        points: (n,) which measuring points of the plan these are, from 0.
        sites: (k, 2) middles of the boxes that are put up as landmarks, in W [m].
    """

    route: np.ndarray
    stops: np.ndarray
    points: np.ndarray
    sites: np.ndarray

    def __deepcopy__(self, memo: dict) -> "MeasuringRoute":
        return self


def straight_route(plan: FloorPlan) -> MeasuringRoute:
    """What the source drives without planning: straight to the measuring points in their order, no landmarks added."""
    every = np.arange(len(plan.measuring_points))
    return MeasuringRoute(plan.measuring_points, every, every, np.zeros((0, 2)))


def known_map(plan: FloorPlan, way: MeasuringRoute, config: HallConfig) -> OccupancyGrid:
    """The plan with the landmarks that were put up, as a map."""
    drawn = plan.with_boxes(way.sites, config.box_side)
    return OccupancyGrid.from_plan(drawn.occupied.T, drawn.resolution, drawn.origin)


def behaviors_path(config: MeasuringRunConfig) -> Path:
    """The file of the robot's behaviours. Raises `ScenarioError` when there is none."""
    folder = MODELS_DIR / config.robot.model
    for path in (folder / f"{config.behaviors}.yaml", Path(config.behaviors)):
        if path.is_file():
            return path
    raise ScenarioError("no such file", key="behaviors", value=config.behaviors, valid="behaviors, or a YAML file")


def make_illuminate(
    config: MeasuringRunConfig, plan: FloorPlan, way: MeasuringRoute, *, seed: int, meshcat: Meshcat | None = None
) -> Diagram:
    """Builds the run: station → odometry, laser → localisation → tour → behaviours → coordination → station.

    The robot starts where the plan says, and its map frame is that of the plan. The localiser's map is the plan with
    the landmarks, as they were put up, if the configuration says so.

    Raises:
        ScenarioError, ConfigError, WorldError: what the configuration says cannot be built.
    """
    if config.lidar is None or config.meter is None:
        key = "lidar" if config.lidar is None else "meter"
        raise ConfigError("the run needs one", key=key, value=None, valid="a mapping, or {}")
    if config.hall.lamps is not None and not config.hall.lamps:
        raise ConfigError("no lamp", key="hall.lamps", value=[], valid="at least one, or null for lamps in rows")
    builder = DiagramBuilder()
    world_seed = seed if config.world.seed is None else config.world.seed
    world = build_hall(plan, way.sites, config.hall, world_seed)
    height = config.robot.known_model().base_height
    x, y, heading = (float(value) for value in plan.start)
    robot = replace(config.robot, start_xyz=[x, y, height], start_yaw_deg=float(np.rad2deg(heading)))
    station = builder.AddSystem(make_station(replace(config, robot=robot), seed=seed, meshcat=meshcat, world=world))
    X_WB0 = robot.X_WB()
    lidar: Lidar = subsystem(station, "lidar")
    behaviors = read_behaviors(behaviors_path(config))

    odometry = builder.AddNamedSystem("odometry", Odometry6Dof(config.odometry, X_OB0=X_WB0))
    laser = builder.AddNamedSystem("laser", LaserRing(lidar.pattern))
    localizer = builder.AddNamedSystem(
        "localizer",
        EvolutionLocalizer(
            config.localizer,
            grid=known_map(plan, way, config.hall) if config.map_from_plan else None,
            start=plan.start,
            X_BS=planar_pose(X_B(station, "lidar")),
            period=config.localizer_period,
            seed=sensor_seed(seed, "localizer"),
        ),
    )
    tour = builder.AddNamedSystem("tour", MeasuringTour(config.tour, way.route, way.stops))
    seeking = builder.AddNamedSystem("goal_seeking", FuzzyGoalSeeking(behaviors.goal_seeking))
    avoidance = builder.AddNamedSystem("obstacle_avoidance", FuzzyObstacleAvoidance(behaviors.obstacle_avoidance))
    directions = behaviors.obstacle_avoidance.directions()
    coordinator = builder.AddNamedSystem("coordinator", BehaviorCoordinator(behaviors.coordinator, directions))

    connect(builder, station, "track_displacements", odometry)
    connect(builder, station, "rpy", odometry)
    connect(builder, station, "scan_S", laser)
    connect(builder, laser, "laser_scan", localizer)
    connect(builder, odometry, "X_OB", localizer)
    connect(builder, localizer, "X_MB", tour)
    connect(builder, localizer, "lost", tour)
    connect(builder, station, "illuminance", tour)
    connect(builder, localizer, "X_MB", seeking)
    connect(builder, tour, "goal", seeking)
    for behavior in (avoidance, coordinator):
        connect(builder, station, "scan_S", behavior)
        connect(builder, station, "X_BS", behavior)
        connect(builder, seeking, "goal_error", behavior)
    connect(builder, seeking, "twist", coordinator, "goal_twist")
    connect(builder, avoidance, "twist", coordinator, "avoidance_twist")
    connect(builder, avoidance, "free_ways", coordinator)
    connect(builder, tour, "stop", coordinator)
    connect(builder, coordinator, "twist_command", station)
    export_outputs(builder)
    diagram = builder.Build()
    diagram.set_name("illuminate")
    return diagram
