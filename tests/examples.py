"""A running example of every system: a root diagram of the shipped kind and the system inside it.

`EXAMPLES[name](seed)` gives (root, system). A new system gets a line here, or the contract test fails.
"""

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from naraha.diagrams.extrinsics import ExtrinsicsScenario, make_extrinsics
from naraha.diagrams.mapping import MapScenario, make_mapping
from naraha.diagrams.merging import MergeScenario, make_merging
from naraha.diagrams.scenario import load_scenario
from naraha.diagrams.station import RobotConfig, StationConfig, make_station
from naraha.diagrams.survey import SurveyScenario, make_survey
from naraha.systems.changes import make_seen_space, write_seen
from naraha.systems.changes.sight import Rays
from naraha.systems.clouds import LocalCloud
from naraha.systems.drive import TiltConfig
from naraha.systems.routes import LearningProgress, RouteLearner, RouteLearnerConfig, SurveyLoop, Voxels
from naraha.systems.sensing import LidarConfig, Scan, write_cloud
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.framework import Diagram, DiagramBuilder, LeafSystem, System
from pydrake.systems.primitives import ConstantValueSource, ConstantVectorSource

from tests.behaviors.behavior_examples import BEHAVIOR_EXAMPLES
from tests.localization.localization_examples import LOCALIZATION_EXAMPLES
from tests.placement.placement_examples import PLACEMENT_EXAMPLES
from tests.routes.maps import water_map
from tests.routes.route_examples import ROUTE_EXAMPLES, with_inputs
from tests.sensing.meter_rig import meter_example
from tests.snake.robot import controlled_snake
from tests.snake.stuck_snake import moving_snake
from tests.traversability.unicycle_world import build as build_box_world

Example = Callable[[int], tuple[System, LeafSystem]]


def leaves(system: System) -> list[LeafSystem]:
    """All leaf systems of a diagram, at any depth."""
    if isinstance(system, Diagram):
        return [leaf for child in system.GetSystems() for leaf in leaves(child)]
    return [system]


def find(root: System, name: str) -> tuple[System, LeafSystem]:
    return root, next(leaf for leaf in leaves(root) if type(leaf).__name__ == name)


def short_survey(seed: int) -> SurveyScenario:
    return load_scenario(SurveyScenario, "stair_hall", seed=seed)


def in_survey(name: str, meshcat: bool = False) -> Example:
    return lambda seed: find(make_survey(short_survey(seed), Meshcat() if meshcat else None), name)


def in_mapping(name: str, seed: int, meshcat: Meshcat | None = None) -> tuple[System, LeafSystem]:
    folder = Path(tempfile.gettempdir()) / f"naraha-replay-{os.getpid()}-{seed}"  # skipped scans are named in an output
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng(seed)
    for i in range(6):
        write_cloud(folder / f"{i}.ply", PointCloud(rng.uniform(-3, 3, (500, 3)).astype(np.float32)))
    (folder / "3.ply").write_text("not a scan")
    return find(make_mapping(MapScenario(), sorted(folder.iterdir()), meshcat), name)


def in_merging(name: str, seed: int) -> tuple[System, LeafSystem]:
    """Three views of one cloud of points, the second turned by a little."""
    folder = Path(tempfile.gettempdir()) / f"naraha-views-{os.getpid()}-{seed}"
    folder.mkdir(exist_ok=True)
    points = np.random.default_rng(seed).uniform([-3, -2, 0], [3, 2, 2], (800, 3)).astype(np.float32)
    for i in range(3):
        write_cloud(folder / f"{i}.ply", PointCloud(points + np.float32([0.1 * i, 0, 0])))
    return find(make_merging(MergeScenario(), sorted(folder.iterdir())), name)


def in_update(name: str, seed: int) -> tuple[System, LeafSystem]:
    """A survey that brings one up to date of which there is only a cloud and the space around it."""
    folder = Path(tempfile.gettempdir()) / f"naraha-earlier-{os.getpid()}-{seed}"
    folder.mkdir(exist_ok=True)
    points = np.random.default_rng(seed).uniform([-9, -6, 0], [9, 6, 2], (800, 3)).astype(np.float32)
    write_cloud(folder / "survey_map.ply", PointCloud(points))
    write_seen(folder / "survey_seen.npz", make_seen_space([Rays(np.zeros(3), points, 0.0)]))
    scenario = short_survey(seed)
    scenario.earlier = str(folder)
    return find(make_survey(scenario), name)


def in_extrinsics(name: str, seed: int) -> tuple[System, LeafSystem]:
    return find(make_extrinsics(load_scenario(ExtrinsicsScenario, "extrinsics", seed=seed)), name)


def learning_a_route(seed: int) -> tuple[System, LeafSystem]:
    """A learner in a hall with water between start and goal; it is not done after the first updates."""
    grid, start, goal = water_map(seed)
    learner = RouteLearner(RouteLearnerConfig(steps_per_update=2000, seed=seed))
    builder = DiagramBuilder()
    builder.AddSystem(learner)
    for name, value in (("start", start), ("goal", np.array(goal))):
        builder.Connect(builder.AddSystem(ConstantVectorSource(value)).get_output_port(), learner.GetInputPort(name))
    source = builder.AddSystem(ConstantValueSource(AbstractValue.Make(grid)))
    builder.Connect(source.get_output_port(), learner.GetInputPort("route_grid"))
    return builder.Build(), learner


def looping(seed: int) -> tuple[System, LeafSystem]:
    """A survey loop in a hall with water; nobody learns or drives for it."""
    grid, start, _ = water_map(seed)
    voxels = Voxels(np.zeros((0, 3), np.int64), np.zeros(0, np.uint8), 0.1)
    return with_inputs(
        SurveyLoop(),
        route_grid=grid,
        voxels=voxels,
        X_MB=RigidTransform([*start[:2], 0.1]),
        learning=LearningProgress(),
        routes=(),
        follower_status="idle",
        follower_pose=np.zeros(3),
        follower_twist=np.zeros(2),
        choice=np.array([-1.0]),
    )


def remembering_scans(seed: int) -> tuple[System, LeafSystem]:
    """A local cloud with one scan of a plain before it."""
    points = np.random.default_rng(seed).uniform([-3, -3, -0.5], [3, 3, -0.45], (500, 3)).astype(np.float32)
    local_cloud = LocalCloud()
    builder = DiagramBuilder()
    builder.AddSystem(local_cloud)
    scan = Scan(PointCloud(points), 0.0, 0.0, 0)
    for name, value in (("scan_S", scan), ("X_OB", RigidTransform()), ("X_BS", RigidTransform([0.1, 0, 0.5]))):
        source = builder.AddSystem(ConstantValueSource(AbstractValue.Make(value)))
        builder.Connect(source.get_output_port(), local_cloud.GetInputPort(name))
    return builder.Build(), local_cloud


def in_box_world(name: str) -> Example:
    """A unicycle that drives around a box, with noise on its scans."""
    return lambda seed: find(build_box_world([(1.5, -0.3, 1.8, 0.3)], (4.0, 0.0), noise=0.005, seed=seed), name)


def on_pioneer(name: str) -> Example:
    """A Pioneer that drives a curve while its LiDAR tilts."""

    def example(seed: int) -> tuple[System, LeafSystem]:
        config = StationConfig(robot=RobotConfig(model="pioneer"), lidar=LidarConfig(pattern="utm30lx"))
        config.tilt = TiltConfig()
        builder = DiagramBuilder()
        station = builder.AddSystem(make_station(config, seed=seed))
        twist = builder.AddSystem(ConstantVectorSource([0.3, 0.2]))
        builder.Connect(twist.get_output_port(), station.GetInputPort("twist_command"))
        return find(builder.Build(), name)

    return example


EXAMPLES: dict[str, Example] = {
    **ROUTE_EXAMPLES,
    **PLACEMENT_EXAMPLES,
    **BEHAVIOR_EXAMPLES,
    **LOCALIZATION_EXAMPLES,
    **{
        name: in_survey(name)
        for name in (
            "BodyPose",
            "CameraFusion",
            "DepthCamera",
            "DoseMapper",
            "FlipperDriver",
            "FlipperRule",
            "GammaCounter",
            "HeatDetector",
            "Imu",
            "KanayamaTracking",
            "KeyframeAssembler",
            "Lidar",
            "NirCamera",
            "OccupancyMap",
            "Odometry6Dof",
            "PanTilt",
            "PanTiltSweep",
            "PointClasses",
            "PoseGraphSlam",
            "ScanMatcher",
            "SemanticMap",
            "SurveyMap",
            "ThermalCamera",
            "TrackDriver",
            "TrackEncoders",
            "WaterDetector",
            "WaypointTour",
        )
    },
    "ExtrinsicCalibrator": lambda seed: in_extrinsics("ExtrinsicCalibrator", seed),
    "IlluminanceMeter": meter_example,
    "LocalCloud": remembering_scans,
    "KeyframeDisplay": lambda seed: in_mapping("KeyframeDisplay", seed, Meshcat()),
    "RouteLearner": learning_a_route,
    "SurveyLoop": looping,
    "ScanReplay": lambda seed: in_mapping("ScanReplay", seed),
    "SemanticDisplay": in_survey("SemanticDisplay", meshcat=True),
    **{name: on_pioneer(name) for name in ("TiltEncoder", "TiltSweep", "WheelDriver")},
    **{
        name: lambda seed, name=name: find(moving_snake(seed), name)  # type: ignore[misc]
        for name in (
            "ActuatorFaults",
            "ContactPads",
            "FisheyeCamera",
            "InertialSpeed",
            "RangeSensors",
            "RecoveryPlanner",
            "SnakePilot",
            "StuckDetector",
            "TipOverMargin",
        )
    },
    "PictureBoard": lambda seed: find(moving_snake(seed, Meshcat()), "PictureBoard"),
    "SnakeDisplay": lambda seed: find(moving_snake(seed, Meshcat()), "SnakeDisplay"),
    "NullSpaceRecovery": lambda seed: find(controlled_snake(), "NullSpaceRecovery"),
    "ShiftControl": lambda seed: find(controlled_snake(), "ShiftControl"),
    "SnakeDrives": lambda seed: find(controlled_snake(), "SnakeDrives"),
    "SurveyUpdate": lambda seed: in_update("SurveyUpdate", seed),
    **{
        name: in_box_world(name)
        for name in (
            "FuzzyTraversability",
            "FuzzyVfhController",
            "PolarRiskHistogram",
            "RiskMemory",
            "TerrainFeatures",
        )
    },
    "ViewpointMerger": lambda seed: in_merging("ViewpointMerger", seed),
}
