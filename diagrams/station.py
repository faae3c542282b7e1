"""The station: a robot with its driver and sensors in a world, as one diagram."""

from dataclasses import dataclass, field, replace

import numpy as np
from naraha.models import MODELS_DIR
from naraha.models.worlds import World, load_world
from naraha.systems.config import quantity
from naraha.systems.drive import CrawlerDriver
from naraha.systems.errors import ConfigError, ScenarioError, WorldError
from naraha.systems.sensing import BodyPose, Imu, ImuConfig, Lidar, LidarConfig, RayScene, welded_frames
from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams
from pydrake.manipulation import ApplyDriverConfigs
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import (
    AddModel,
    ModelDirective,
    ModelDirectives,
    ModelInstanceInfo,
    Parser,
    ProcessModelDirectives,
)
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant, MultibodyPlantConfig
from pydrake.systems.framework import Diagram, DiagramBuilder, System
from pydrake.systems.lcm import LcmBuses

from .seeds import sensor_seed
from .sensor_head import HeadConfig, apply_head
from .wiring import connect, subsystem

# Beams start inside these housings, which are transparent to them.
TRANSPARENT = ["robot::lidar_visual_*", "robot::mast_visual_*"]


@dataclass(kw_only=True)
class WorldConfig:
    """Which world."""

    # A shipped world, or a YAML file.
    name: str = "stair_hall"
    # Seed of the world's random parts; the scenario's seed when null.
    seed: int | None = None


@dataclass(kw_only=True)
class RobotConfig:
    """Which robot, where it starts, and its driver."""

    # A model under models/: the name of its URDF.
    model: str = "crawler"
    # Start in the world [m], height of the base's origin over the ground included.
    start_xyz: list[float] = quantity([0.0, 0.0, 0.08], unit="m")
    # Heading at the start [deg].
    start_yaw_deg: float = quantity(0.0, unit="deg")
    # Driver of the model.
    driver: CrawlerDriver = field(default_factory=CrawlerDriver)

    def X_WB(self) -> RigidTransform:
        """Pose of the base at the start."""
        return RigidTransform(RollPitchYaw(0, 0, np.deg2rad(self.start_yaw_deg)), np.array(self.start_xyz))


@dataclass(kw_only=True)
class StationConfig:
    """Everything that is simulated around the estimators and controllers."""

    world: WorldConfig = field(default_factory=WorldConfig)
    # Further models by Drake's own directives; `package://naraha/` is the models folder.
    directives: list[ModelDirective] = field(default_factory=list)
    robot: RobotConfig = field(default_factory=RobotConfig)
    # `lagged` makes skid turning independent of the time step.
    plant: MultibodyPlantConfig = field(
        default_factory=lambda: MultibodyPlantConfig(time_step=0.004, discrete_contact_approximation="lagged")
    )
    lidar: LidarConfig | None = field(default_factory=LidarConfig)
    imu: ImuConfig = field(default_factory=ImuConfig)
    # Cameras and gamma counter on the mast; null leaves them out.
    head: HeadConfig | None = None


def shipped_robots() -> dict[str, str]:
    """Package URLs of the robots, by the name of the model."""
    return {path.stem: f"package://naraha/{path.relative_to(MODELS_DIR)}" for path in MODELS_DIR.glob("*/*.urdf")}


def station_world(config: StationConfig, seed: int) -> World:
    """The world that `config` names, with its surfaces. Raises `WorldError`."""
    return load_world(config.world.name, seed if config.world.seed is None else config.world.seed)


def make_station(config: StationConfig, *, seed: int, meshcat: Meshcat | None = None) -> Diagram:
    """Builds the station.

    Inputs: `twist_command` (2), `flipper_preset` (str); the driver's configuration may add or replace some.
    Outputs: `scan_S` (with a LiDAR), `rpy` (3), `gyro` (3), `accelerometer` (3), `track_displacements` (2),
    `track_speeds` (2), `flipper_angles` (4), `active_preset` (str), those of the head (see `apply_head`), and for
    metrics only `cheat.X_WB`.

    Subsystems: `plant`, `scene_graph`, `robot.driver`, `imu`, `lidar`, `truth`, and those of the head.

    Raises:
        ScenarioError, WorldError, ConfigError: unknown robot or world, no ground below the start, values out of range.
    """
    if config.plant.time_step <= 0:
        raise ConfigError("out of range", key="plant.time_step", value=config.plant.time_step, valid="> 0 s")
    world = station_world(config, seed)
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlant(config.plant, builder)
    world.add_to(plant)
    models = add_models(config, plant)
    plant.Finalize()
    ApplyDriverConfigs(
        driver_configs={"robot": _driver(config.robot, seed)},
        sim_plant=plant,
        models_from_directives=models,
        lcm_buses=LcmBuses(),
        builder=builder,
    )
    driver = builder.GetSubsystemByName("robot.driver")
    _apply_imu(config, plant, builder, seed)
    connect(builder, builder.GetSubsystemByName("imu"), "rpy", driver)
    if config.lidar is not None or config.head is not None:
        scene = RayScene(scene_graph.model_inspector(), world.surface_table(), exclude=TRANSPARENT, threads=0)
        if config.lidar is not None:
            _apply_lidar(config.lidar, scene, plant, builder, seed)
        if config.head is not None:
            apply_head(config.head, scene, plant, builder, seed=seed)
    _apply_truth(plant, builder)
    if meshcat is not None:
        parameters = MeshcatVisualizerParams(publish_period=0.1, prefix="station")
        MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat, parameters)
    for name in ("twist_command", "track_speed_command", "flipper_preset"):
        if driver.HasInputPort(name):
            builder.ExportInput(driver.GetInputPort(name), name)
    for name in ("track_displacements", "track_speeds", "flipper_angles", "active_preset"):
        builder.ExportOutput(driver.GetOutputPort(name), name)
    station = builder.Build()
    station.set_name("station")
    _check_ground(config, station)
    return station


def add_models(config: StationConfig, plant: MultibodyPlant) -> list[ModelInstanceInfo]:
    """Adds the robot, named `robot`, and the scenario's own directives. Raises `ScenarioError`."""
    robots = shipped_robots()
    if config.robot.model not in robots:
        raise ScenarioError("unknown robot", key="robot.model", value=config.robot.model, valid=sorted(robots))
    parser = Parser(plant)
    parser.package_map().Add("naraha", str(MODELS_DIR))
    robot = ModelDirective(add_model=AddModel(name="robot", file=robots[config.robot.model]))
    directives = ModelDirectives(directives=[robot, *config.directives])
    try:
        models = ProcessModelDirectives(directives, parser)
    except RuntimeError as error:
        raise ScenarioError(" ".join(str(error).split()), key="directives") from None
    plant.SetDefaultFloatingBaseBodyPose(
        plant.GetBodyByName("base", plant.GetModelInstanceByName("robot")), config.robot.X_WB()
    )
    return models


def _driver(robot: RobotConfig, seed: int) -> CrawlerDriver:
    """The robot's driver, whose encoders draw their scale errors from the run's seed."""
    encoders = robot.driver.encoders
    return replace(robot.driver, encoders=replace(encoders, seed=sensor_seed(seed, f"encoders {encoders.seed}")))


def _apply_imu(config: StationConfig, plant: MultibodyPlant, builder: DiagramBuilder, seed: int) -> None:
    body = plant.GetBodyByName("imu", plant.GetModelInstanceByName("robot"))
    imu = Imu(
        config.imu,
        body_index=body.index(),
        gravity=plant.gravity_field().gravity_vector(),
        seed=sensor_seed(seed, "imu"),
        initial_yaw=np.deg2rad(config.robot.start_yaw_deg),
    )
    builder.AddNamedSystem("imu", imu)
    for name in ("body_poses", "body_spatial_velocities", "body_spatial_accelerations"):
        connect(builder, plant, name, imu)
    for name in ("rpy", "gyro", "accelerometer"):
        builder.ExportOutput(imu.GetOutputPort(name), name)


def _apply_lidar(
    config: LidarConfig, scene: RayScene, plant: MultibodyPlant, builder: DiagramBuilder, seed: int
) -> None:
    body = plant.GetBodyByName("lidar", plant.GetModelInstanceByName("robot"))
    robot = plant.GetBodyIndices(plant.GetModelInstanceByName("robot"))
    lidar = Lidar(
        config,
        scene=scene,
        parent_frame=plant.GetBodyFrameIdOrThrow(body.index()),
        X_PS=RigidTransform(),
        rigid_frames=welded_frames(plant, body),
        own_frames=[plant.GetBodyFrameIdOrThrow(i) for i in robot],
        seed=sensor_seed(seed, "lidar"),
    )
    builder.AddNamedSystem("lidar", lidar)
    connect(builder, builder.GetSubsystemByName("scene_graph"), "query", lidar, "geometry_query")
    builder.ExportOutput(lidar.GetOutputPort("scan_S"), "scan_S")


def _apply_truth(plant: MultibodyPlant, builder: DiagramBuilder) -> None:
    truth = builder.AddNamedSystem("truth", BodyPose.of(plant, "base", "robot"))
    connect(builder, plant, "body_poses", truth)
    builder.ExportOutput(truth.GetOutputPort("X_WB"), "cheat.X_WB")


def _check_ground(config: StationConfig, station: Diagram) -> None:
    """Raises `WorldError` when nothing that carries is within 0.5 m below the robot's start."""
    context = station.CreateDefaultContext()
    scene_graph = subsystem(station, "scene_graph")
    query = scene_graph.GetOutputPort("query").Eval(scene_graph.GetMyContextFromRoot(context))
    inspector = query.inspector()
    start = config.robot.X_WB().translation()
    for depth in np.arange(0.0, 0.51, 0.1):
        distances = query.ComputeSignedDistanceToPoint(start - [0, 0, depth], 0.1)
        if any(inspector.GetFrameId(d.id_G) == inspector.world_frame_id() for d in distances):
            return
    raise WorldError(
        "no ground below the robot's start", key="robot.start_xyz", value=config.robot.start_xyz, valid="over a floor"
    )


def X_B(station: System, name: str) -> RigidTransform:
    """Pose in the robot's base B of a frame of its model, such as `lidar` (S) or `depth_camera` (D)."""
    plant = subsystem(station, "plant")
    robot = plant.GetModelInstanceByName("robot")
    context = plant.CreateDefaultContext()
    base, frame = plant.GetFrameByName("base", robot), plant.GetFrameByName(name, robot)
    return plant.CalcRelativeTransform(context, base, frame)
