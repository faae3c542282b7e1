"""The station: a robot with its driver and sensors in a world, as one diagram."""

from dataclasses import dataclass, field

import numpy as np
from naraha.models import MODELS_DIR
from naraha.models.worlds import World, load_world
from naraha.systems.drive import TiltConfig, TiltEncoder, TiltSweep
from naraha.systems.errors import ConfigError, ScenarioError, WorldError
from naraha.systems.sensing import (
    BodyPose,
    IlluminanceMeter,
    IlluminanceMeterConfig,
    Imu,
    ImuConfig,
    Lidar,
    LidarConfig,
    RayScene,
    make_emitters,
    welded_frames,
)
from pydrake.common.value import Value
from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams
from pydrake.manipulation import ApplyDriverConfigs
from pydrake.math import RigidTransform
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
from pydrake.systems.primitives import ConstantValueSource

from .robots import RobotConfig, seeded_driver
from .seeds import sensor_seed
from .sensor_head import HeadConfig, apply_head
from .wiring import connect, subsystem

# Beams start inside these housings, which are transparent to them.
TRANSPARENT = ["robot::lidar_visual_*", "robot::mast_visual_*"]

_MAX_OVERLAP = 0.01
"""[m] by how much the robot may overlap the world at the start."""


@dataclass(kw_only=True)
class WorldConfig:
    """Which world."""

    # A shipped world, or a YAML file.
    name: str = "stair_hall"
    # Seed of the world's random parts; the scenario's seed when null.
    seed: int | None = None


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
    # Sweep of the LiDAR of a robot that has it on a tilt unit; null holds it level.
    tilt: TiltConfig | None = None
    imu: ImuConfig = field(default_factory=ImuConfig)
    # Cameras and gamma counter on the mast; null leaves them out.
    head: HeadConfig | None = None
    # Illuminance meter of a robot that has one; null leaves it out.
    meter: IlluminanceMeterConfig | None = None


def station_world(config: StationConfig, seed: int) -> World:
    """The world that `config` names, with its surfaces. Raises `WorldError`."""
    return load_world(config.world.name, seed if config.world.seed is None else config.world.seed)


def make_station(
    config: StationConfig, *, seed: int, meshcat: Meshcat | None = None, world: World | None = None
) -> Diagram:
    """Builds the station, in `world` if one is given, else in the one that `config` names.

    Inputs: `twist_command` (2), or `track_speed_command` (2) if the driver's configuration says so; of a robot with
    flippers `flipper_preset` (str).
    Outputs: `track_displacements` (2) and `track_speeds` (2) of tracks or wheels, `rpy` (3), `gyro` (3),
    `accelerometer` (3); with a LiDAR `scan_S`, and `X_BS` (RigidTransform), its measured pose in the base at the end of
    that scan; of a robot with flippers `flipper_angles` (4), `active_preset` (str); with a tilt unit and a LiDAR
    `tilt_angle` (1); those of the head (see `apply_head`); with a meter `illuminance` (1); and for metrics only
    `cheat.X_WB` and `cheat.illuminance` (1).

    Subsystems: `plant`, `scene_graph`, `robot.driver`, `imu`, `lidar`, `lidar_pose`, `tilt_sweep`, `meter`, `truth`,
    and those of the head.

    Raises:
        ScenarioError, WorldError, ConfigError: unknown robot or world, no ground below the start, values out of range.
    """
    if config.plant.time_step <= 0:
        raise ConfigError("out of range", key="plant.time_step", value=config.plant.time_step, valid="> 0 s")
    world = world or station_world(config, seed)
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlant(config.plant, builder)
    world.add_to(plant)
    models = add_models(config, plant)
    plant.Finalize()
    ApplyDriverConfigs(
        driver_configs={"robot": seeded_driver(config.robot, seed)},
        sim_plant=plant,
        models_from_directives=models,
        lcm_buses=LcmBuses(),
        builder=builder,
    )
    driver = builder.GetSubsystemByName("robot.driver")
    _apply_imu(config, plant, builder, seed)
    if driver.HasInputPort("rpy"):
        connect(builder, builder.GetSubsystemByName("imu"), "rpy", driver)
    _apply_tilt(config.tilt, driver, builder)
    if config.lidar is not None or config.head is not None or config.meter is not None:
        scene = RayScene(scene_graph.model_inspector(), world.surface_table(), exclude=TRANSPARENT, threads=0)
        if config.lidar is not None:
            lidar = _apply_lidar(config.lidar, scene, plant, builder, seed)
            _apply_lidar_pose(config.tilt, lidar.pattern.period, plant, builder, seed)
        if config.head is not None:
            apply_head(config.head, scene, plant, builder, seed=seed)
        if config.meter is not None:
            _apply_meter(config.meter, world, scene, plant, builder, seed)
    _apply_truth(plant, builder)
    if meshcat is not None:
        parameters = MeshcatVisualizerParams(publish_period=0.1, prefix="station")
        MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat, parameters)
    for name in ("twist_command", "track_speed_command", "flipper_preset"):
        if driver.HasInputPort(name):
            builder.ExportInput(driver.GetInputPort(name), name)
    for name in ("track_displacements", "track_speeds", "flipper_angles", "active_preset"):
        if driver.HasOutputPort(name):
            builder.ExportOutput(driver.GetOutputPort(name), name)
    station = builder.Build()
    station.set_name("station")
    _check_ground(config, station)
    return station


def add_models(config: StationConfig, plant: MultibodyPlant) -> list[ModelInstanceInfo]:
    """Adds the robot, named `robot`, and the scenario's own directives. Raises `ScenarioError`."""
    parser = Parser(plant)
    parser.package_map().Add("naraha", str(MODELS_DIR))
    robot = ModelDirective(add_model=AddModel(name="robot", file=config.robot.known_model().url))
    directives = ModelDirectives(directives=[robot, *config.directives])
    try:
        models = ProcessModelDirectives(directives, parser)
    except RuntimeError as error:
        raise ScenarioError(" ".join(str(error).split()), key="directives") from None
    plant.SetDefaultFloatingBaseBodyPose(
        plant.GetBodyByName("base", plant.GetModelInstanceByName("robot")), config.robot.X_WB()
    )
    return models


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
) -> Lidar:
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
    return lidar


def _apply_meter(
    config: IlluminanceMeterConfig,
    world: World,
    scene: RayScene,
    plant: MultibodyPlant,
    builder: DiagramBuilder,
    seed: int,
) -> None:
    robot = plant.GetModelInstanceByName("robot")
    if not plant.HasFrameNamed("meter", robot):
        raise ConfigError("the robot has no illuminance meter", key="meter", valid="null, or another robot.model")
    frame = plant.GetFrameByName("meter", robot)
    meter = IlluminanceMeter(
        config,
        emitters=make_emitters(world.lamps, world.windows, where="world"),
        scene=scene,
        parent_frame=plant.GetBodyFrameIdOrThrow(frame.body().index()),
        X_PI=frame.GetFixedPoseInBodyFrame(),
        own_frames=[plant.GetBodyFrameIdOrThrow(i) for i in plant.GetBodyIndices(robot)],
        seed=sensor_seed(seed, "meter"),
    )
    builder.AddNamedSystem("meter", meter)
    connect(builder, builder.GetSubsystemByName("scene_graph"), "query", meter, "geometry_query")
    for name in ("illuminance", "cheat.illuminance"):
        builder.ExportOutput(meter.GetOutputPort(name), name)


def _apply_tilt(config: TiltConfig | None, driver: System, builder: DiagramBuilder) -> None:
    if driver.HasInputPort("tilt_setpoint"):
        sweep = TiltSweep(config or TiltConfig(lowest_deg=0.0, highest_deg=0.0))
        connect(builder, builder.AddNamedSystem("tilt_sweep", sweep), "tilt_setpoint", driver)
    elif config is not None:
        raise ConfigError("the robot has no tilt unit", key="tilt", valid="null, or another robot.model")


def _apply_lidar_pose(
    config: TiltConfig | None, period: float, plant: MultibodyPlant, builder: DiagramBuilder, seed: int
) -> None:
    robot = plant.GetModelInstanceByName("robot")
    if builder.HasSubsystemNamed("tilt_sweep"):
        encoder = TiltEncoder(config or TiltConfig(), plant, robot, period=period, seed=sensor_seed(seed, "tilt"))
        builder.AddNamedSystem("lidar_pose", encoder)
        builder.Connect(plant.get_state_output_port(robot), encoder.GetInputPort("state"))
        for name in ("tilt_angle", "X_BS"):
            builder.ExportOutput(encoder.GetOutputPort(name), name)
    else:
        X_BS = _pose_in_base(plant, "lidar")
        pose = builder.AddNamedSystem("lidar_pose", ConstantValueSource(Value(X_BS)))
        builder.ExportOutput(pose.get_output_port(), "X_BS")


def _apply_truth(plant: MultibodyPlant, builder: DiagramBuilder) -> None:
    truth = builder.AddNamedSystem("truth", BodyPose.of(plant, "base", "robot"))
    connect(builder, plant, "body_poses", truth)
    builder.ExportOutput(truth.GetOutputPort("X_WB"), "cheat.X_WB")


def _check_ground(config: StationConfig, station: Diagram) -> None:
    """Raises `WorldError` unless the robot starts clear of the world with ground within 0.5 m below it."""
    context = station.CreateDefaultContext()
    scene_graph = subsystem(station, "scene_graph")
    query = scene_graph.GetOutputPort("query").Eval(scene_graph.GetMyContextFromRoot(context))
    inspector = query.inspector()
    start = config.robot.X_WB().translation()
    for pair in query.ComputePointPairPenetration():
        if pair.depth > _MAX_OVERLAP:
            names = " and ".join(inspector.GetName(id) for id in (pair.id_A, pair.id_B))
            raise WorldError(
                f"the robot starts {1e3 * pair.depth:.0f} mm inside something ({names})",
                key="robot.start_xyz",
                value=start.tolist(),
                valid=f"clear of the world, {config.robot.known_model().base_height:g} m over its floor",
            )
    for depth in np.arange(0.0, 0.51, 0.1):
        distances = query.ComputeSignedDistanceToPoint(start - [0, 0, depth], 0.1)
        if any(inspector.GetFrameId(d.id_G) == inspector.world_frame_id() for d in distances):
            return
    raise WorldError(
        "no ground below the robot's start", key="robot.start_xyz", value=config.robot.start_xyz, valid="over a floor"
    )


def X_B(station: System, name: str) -> RigidTransform:
    """Pose in the robot's base B of a frame of its model, such as `lidar` (S) or `depth_camera`, all joints at 0."""
    return _pose_in_base(subsystem(station, "plant"), name)


def _pose_in_base(plant: MultibodyPlant, name: str) -> RigidTransform:
    robot = plant.GetModelInstanceByName("robot")
    context = plant.CreateDefaultContext()
    base, frame = plant.GetFrameByName("base", robot), plant.GetFrameByName(name, robot)
    return plant.CalcRelativeTransform(context, base, frame)
