"""The snake's station: the robot with its driver and sensors in a world, as one diagram."""

from dataclasses import dataclass, field

import numpy as np
from naraha.models.snake.snake_model import SnakeModel
from naraha.models.snake.urdf import snake_urdf
from naraha.models.worlds import World
from naraha.systems.drive.snake_driver import SnakeDriver
from naraha.systems.errors import ConfigError
from naraha.systems.sensing import BodyPose, Imu, ImuConfig, RayScene, welded_frames
from naraha.systems.sensing.fisheye_camera import FisheyeCamera, FisheyeCameraConfig, geometry_colours
from naraha.systems.snake.contact_pads import ContactPads, ContactPadsConfig, find_pads
from naraha.systems.snake.range_sensors import HalfShape, RangeSensors, RangeSensorsConfig
from naraha.systems.snake.stuck_features import SnakeMeasures
from naraha.systems.snake.tip_over_margin import TipOverMargin, TipOverMarginConfig
from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams, SceneGraph
from pydrake.manipulation import ApplyDriverConfigs
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant, MultibodyPlantConfig
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.lcm import LcmBuses

from .seeds import sensor_seed
from .wiring import connect

# What the driver measures and takes.
MEASUREMENTS = ("joint_angles", "joint_rates", "joint_torques", "wheel_angles", "wheel_speeds", "wheel_torques")
COMMANDS = ("joint_command", "wheel_speed_command", "joint_torque_limit", "wheel_torque_limit")


@dataclass(kw_only=True)
class SnakeStationConfig:
    """The snake, its sensors and the simulation."""

    # Dimensions of the robot.
    snake: SnakeModel = field(default_factory=SnakeModel)
    driver: SnakeDriver = field(default_factory=SnakeDriver)
    # 1, 2, 5 and 10 ms give the same recoveries.
    plant: MultibodyPlantConfig = field(
        default_factory=lambda: MultibodyPlantConfig(time_step=0.005, discrete_contact_approximation="lagged")
    )
    # Sampled with every step of the plant: contact makes the robot tremble, and a slower unit would take every other
    # jolt for all of them.
    imu: ImuConfig | None = field(default_factory=lambda: ImuConfig(period=0.005))
    # Null leaves out a sensor and its outputs.
    pads: ContactPadsConfig | None = field(default_factory=ContactPadsConfig)
    ranges: RangeSensorsConfig | None = field(default_factory=RangeSensorsConfig)
    # The fisheye cameras at head and tail, for operators; both are alike.
    cameras: FisheyeCameraConfig | None = field(default_factory=FisheyeCameraConfig)
    tip_over_margin: TipOverMarginConfig = field(default_factory=TipOverMarginConfig)


def snake_measures(snake: SnakeModel, gravity: float = 9.81) -> SnakeMeasures:
    """The measures of the model that estimators read the measurements with."""
    return SnakeMeasures(
        units=snake.units,
        half_length=snake.half_length,
        wheel_radius=snake.wheel_radius,
        clearance=snake.wheel_radius - snake.belly_depth,
        wheel_side=(snake.tread + snake.wheel_width) / 2 - snake.half_width,
        weight=snake.mass * gravity,
    )


def make_snake_station(
    config: SnakeStationConfig,
    world: World,
    *,
    X_WB: RigidTransform,
    joint_angles: np.ndarray,
    seed: int,
    meshcat: Meshcat | None = None,
) -> Diagram:
    """Builds the station. B is the head link, whose origin is at the nose.

    Inputs: `COMMANDS`, each optional, see `SnakeDrives`. Outputs: `MEASUREMENTS`, `rpy` (3), `gyro` (3),
    `accelerometer` (3), `pad_forces` (4n), `ranges`, `head_image`, `tail_image`, `tip_margin` (1), `support`, and for
    metrics and plots only `cheat.X_WB` and `cheat.body_poses`.

    Subsystems: `plant`, `scene_graph`, `robot.driver`, `imu`, `pads`, `ranges`, `head_camera`, `tail_camera`,
    `tip_over_margin`, `truth`.

    Args:
        joint_angles: (2n - 1,) at the start [rad].

    Raises:
        ConfigError, WorldError: values out of range.
    """
    if config.plant.time_step <= 0:
        raise ConfigError("out of range", key="plant.time_step", value=config.plant.time_step, valid="> 0 s")
    names = config.snake.joint_names()
    if len(joint_angles) != len(names) or not np.all(np.isfinite(joint_angles)):
        raise ConfigError(
            "wrong joint angles", key="joint_angles", value=len(joint_angles), valid=f"{len(names)} finite"
        )
    builder = DiagramBuilder()
    plant, scene_graph = _add_plant(config, world, X_WB, joint_angles, builder)
    _apply_driver(config.driver, plant, builder)
    if config.imu is not None:
        _apply_imu(config.imu, plant, builder, seed)
    if config.pads is not None:
        _apply_pads(config.pads, config.snake.units, plant, scene_graph, builder, seed)
    if config.ranges is not None or config.cameras is not None:
        # The robot itself is left out: no range sensor looks at it, and every moving link would need a ray scene of its
        # own, of which Open3D can hold about a thousand in one process.
        fixed = welded_frames(plant, plant.world_body())
        inspector, surfaces = scene_graph.model_inspector(), world.surface_table()
        scene = RayScene(inspector, surfaces, fixed_frames=fixed, exclude=["robot::*"])
        if config.ranges is not None:
            _apply_ranges(config.ranges, config.snake, scene, plant, builder, seed)
        if config.cameras is not None:
            _apply_cameras(config.cameras, scene, plant, scene_graph, builder, seed)
    _apply_margin(config.tip_over_margin, plant, builder)
    truth = builder.AddNamedSystem("truth", BodyPose.of(plant, "F0", "robot"))
    connect(builder, plant, "body_poses", truth)
    builder.ExportOutput(truth.GetOutputPort("X_WB"), "cheat.X_WB")
    builder.ExportOutput(plant.GetOutputPort("body_poses"), "cheat.body_poses")
    if meshcat is not None:
        parameters = MeshcatVisualizerParams(publish_period=0.05, prefix="station")
        MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat, parameters)
    station = builder.Build()
    station.set_name("station")
    return station


def half_bodies(plant: MultibodyPlant, units: int) -> list[int]:
    """Indices in `body_poses` of the links F0, R0, F1, R1, ... of the snake in a station."""
    robot = plant.GetModelInstanceByName("robot")
    return [int(plant.GetBodyByName(f"{half}{i}", robot).index()) for i in range(units) for half in "FR"]


def _add_plant(
    config: SnakeStationConfig, world: World, X_WB: RigidTransform, joint_angles: np.ndarray, builder: DiagramBuilder
) -> tuple[MultibodyPlant, SceneGraph]:
    """The robot in its world; its model instance is `robot`."""
    plant, scene_graph = AddMultibodyPlant(config.plant, builder)
    world.add_to(plant)
    (model,) = Parser(plant).AddModelsFromString(snake_urdf(config.snake), "urdf")
    plant.RenameModelInstance(model, "robot")
    plant.Finalize()
    plant.SetDefaultFloatingBaseBodyPose(plant.GetBodyByName("F0", model), X_WB)
    for name, angle in zip(config.snake.joint_names(), joint_angles, strict=True):
        plant.GetJointByName(name, model).set_default_angle(float(angle))
    return plant, scene_graph


def _apply_driver(config: SnakeDriver, plant: MultibodyPlant, builder: DiagramBuilder) -> None:
    ApplyDriverConfigs(
        driver_configs={"robot": config},
        sim_plant=plant,
        models_from_directives=[],
        lcm_buses=LcmBuses(),
        builder=builder,
    )
    driver = builder.GetSubsystemByName("robot.driver")
    for name in COMMANDS:
        builder.ExportInput(driver.GetInputPort(name), name)
    for name in MEASUREMENTS:
        builder.ExportOutput(driver.GetOutputPort(name), name)


def _apply_imu(config: ImuConfig, plant: MultibodyPlant, builder: DiagramBuilder, seed: int) -> None:
    body = plant.GetBodyByName("imu", plant.GetModelInstanceByName("robot"))
    gravity = plant.gravity_field().gravity_vector()
    imu = Imu(config, body_index=body.index(), gravity=gravity, seed=sensor_seed(seed, "imu"))
    builder.AddNamedSystem("imu", imu)
    for name in ("body_poses", "body_spatial_velocities", "body_spatial_accelerations"):
        connect(builder, plant, name, imu)
    for name in ("rpy", "gyro", "accelerometer"):
        builder.ExportOutput(imu.GetOutputPort(name), name)


def _apply_cameras(
    config: FisheyeCameraConfig,
    scene: RayScene,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    builder: DiagramBuilder,
    seed: int,
) -> None:
    colours = geometry_colours(scene, scene_graph.model_inspector())
    robot = plant.GetModelInstanceByName("robot")
    for end in ("head", "tail"):
        frame = plant.GetFrameByName(f"{end}_camera", robot)
        camera = FisheyeCamera(
            config,
            scene=scene,
            colours=colours,
            parent_frame=plant.GetBodyFrameIdOrThrow(frame.body().index()),
            X_PC=frame.GetFixedPoseInBodyFrame(),
            rigid_frames=welded_frames(plant, frame.body()),
            seed=sensor_seed(seed, f"{end}_camera"),
        )
        builder.AddNamedSystem(f"{end}_camera", camera)
        builder.Connect(scene_graph.get_query_output_port(), camera.GetInputPort("geometry_query"))
        builder.ExportOutput(camera.GetOutputPort("fisheye_image"), f"{end}_image")


def _apply_pads(
    config: ContactPadsConfig,
    units: int,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    builder: DiagramBuilder,
    seed: int,
) -> None:
    found = find_pads(plant, scene_graph.model_inspector(), plant.GetModelInstanceByName("robot"), units)
    pads = ContactPads(config, pads=found, units=units, seed=sensor_seed(seed, "pads"))
    builder.AddNamedSystem("pads", pads)
    connect(builder, plant, "contact_results", pads)
    builder.ExportOutput(pads.GetOutputPort("pad_forces"), "pad_forces")


def _apply_ranges(
    config: RangeSensorsConfig,
    snake: SnakeModel,
    scene: RayScene,
    plant: MultibodyPlant,
    builder: DiagramBuilder,
    seed: int,
) -> None:
    shape = HalfShape(length=snake.half_length, belly=snake.belly_depth, side=snake.half_width)
    halves = half_bodies(plant, snake.units)
    ranges = RangeSensors(config, scene=scene, halves=halves, shape=shape, seed=sensor_seed(seed, "ranges"))
    builder.AddNamedSystem("ranges", ranges)
    connect(builder, plant, "body_poses", ranges)
    builder.ExportOutput(ranges.GetOutputPort("ranges"), "ranges")


def _apply_margin(config: TipOverMarginConfig, plant: MultibodyPlant, builder: DiagramBuilder) -> None:
    margin = TipOverMargin(config, plant=plant, model=plant.GetModelInstanceByName("robot"))
    builder.AddNamedSystem("tip_over_margin", margin)
    for name in ("contact_results", "body_poses"):
        connect(builder, plant, name, margin)
    for name in ("tip_margin", "support"):
        builder.ExportOutput(margin.GetOutputPort(name), name)
