"""One yard: a look around, a map, a route learnt on it, and the drive along it by SLAM and by odometry."""

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from naraha.diagrams.robot_files import robot_ability
from naraha.diagrams.robots import RobotConfig
from naraha.diagrams.slam import SlamStages, add_maps, add_matching
from naraha.diagrams.station import X_B, StationConfig, make_station
from naraha.diagrams.survey_loop import TouchCount
from naraha.diagrams.wiring import connect, export_outputs
from naraha.models.worlds import World
from naraha.systems.drive import CrawlerDriver
from naraha.systems.routes import (
    RouteGrid,
    RoutesConfig,
    RouteTask,
    VoxelWorldConfig,
    begin,
    learn,
    make_route_grid,
    roll_out,
    smooth_path,
)
from naraha.systems.routes.ground import make_ground
from naraha.systems.routes.islands import find_islands
from naraha.systems.sensing import TrackEncodersConfig
from naraha.systems.slam import Odometry6Dof, ScanMatcherConfig
from naraha.systems.tracking import KanayamaConfig, KanayamaTracking, Path, PathFollower, planar_pose
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantValueSource, MatrixGain

from .transfer_yards import LOOK, build

# What the robot goes by.
POSES = ("slam", "odometry", "encoders")
# [m] Steps that the robot is to drive over: nothing of what stands in the yards.
_MAX_STEP = 0.12
# [m] A goal is at least this far away by the way over the map, [-] and as far as this share of the farthest place; [m]
# it has this much room beyond what the robot needs.
_FAR, _SHARE, _ROOM = 3.5, 0.7, 0.1
# [m] Widest gap between two rings on the floor that is taken for floor.
_GAP = 0.6
# [-] Standard deviation of the scale of each belt's encoder: belts stretch and wear.
_BELTS = 0.01
# [s] Between two looks at the contacts.
_STEP = 0.05


@dataclass(frozen=True)
class Drive:
    """How a drive ended, by the truth.

    Attributes:
        error: distance to the goal [m]. touched: obstacles that were touched. arrived: whether the robot says it has.
        pose_error: distance of the estimate from the truth at the end [m]. time: simulated [s].
    """

    error: float
    touched: int
    arrived: bool
    pose_error: float
    time: float


def station_config(start: np.ndarray, seed: int, lidar: bool) -> StationConfig:
    """The crawler at `start` (3,) x, y, heading [m, m, rad], with or without its LiDAR."""
    encoders = TrackEncodersConfig(scale_error_std=_BELTS)
    robot = RobotConfig(
        start_xyz=[float(v) for v in start[:2]],
        start_yaw_deg=float(np.rad2deg(start[2])),
        driver=CrawlerDriver(encoders=encoders),
    )
    config = StationConfig(robot=robot)
    config.plant.time_step = 0.008
    config.imu.period = 0.02
    if not lidar:
        config.lidar = None
    return config


def make_drive(
    start: np.ndarray, world: World, seed: int, *, pose: str, X_MB0: RigidTransform | None = None
) -> Diagram:
    """A crawler that follows the `Path` on the input `route`.

    Args:
        pose: that it goes by: "slam"; "odometry", encoders and IMU; or "encoders" alone, as the paper's robot.
        X_MB0: where it believes to start; where it does, if not given.
    """
    config = station_config(start, seed, pose == "slam")
    builder = DiagramBuilder()
    station = make_station(config, seed=seed, world=world)
    builder.AddSystem(station)
    X_WB0 = config.robot.X_WB()
    odometry = builder.AddNamedSystem("odometry", Odometry6Dof(X_OB0=X_MB0 or X_WB0))
    connect(builder, station, "track_displacements", odometry)
    source, port = odometry, "X_OB"
    if pose == "encoders":
        gauge = config.robot.known_driver().gauge  # type: ignore[union-attr]
        turn = builder.AddNamedSystem("turn", MatrixGain(np.array([[0, 0], [0, 0], [-1 / gauge, 1 / gauge]])))
        builder.Connect(station.GetOutputPort("track_displacements"), turn.get_input_port())
        builder.Connect(turn.get_output_port(), odometry.GetInputPort("rpy"))
    else:
        connect(builder, station, "rpy", odometry)
    if pose == "slam":
        # Keyframes close together: between the rings of a LiDAR the floor is seen only because the robot moves.
        slam = ScanMatcherConfig(keyframe_distance=0.15, keyframe_angle_deg=8)
        stages = SlamStages(slam=slam, point_classes=None, pose_graph=None, occupancy=None)
        X_BS = X_B(station, "lidar")
        source, port = add_matching(builder, stages, station, odometry=odometry, X_BS=X_BS, X_MB0=X_WB0), "X_MB"
        add_maps(builder, stages, source, p_BS=X_BS.translation())
    follower = builder.AddNamedSystem("follower", PathFollower())
    tracking = builder.AddNamedSystem("tracking", KanayamaTracking(KanayamaConfig()))
    for system in (follower, tracking):
        connect(builder, source, port, system, "X_MB")
    for name in ("reference_pose", "reference_twist"):
        connect(builder, follower, name, tracking)
    connect(builder, tracking, "twist_command", station)
    preset = builder.AddNamedSystem("flipper_preset", ConstantValueSource(Value("auto")))
    builder.Connect(preset.get_output_port(), station.GetInputPort("flipper_preset"))
    builder.ExportInput(follower.GetInputPort("route"), "route")
    export_outputs(builder)
    builder.ExportOutput(source.GetOutputPort(port), "believed")
    return builder.Build()


def follow(diagram: Diagram, simulator: Simulator, path: Path, touches: TouchCount, goal: np.ndarray) -> Drive:
    """Drives along `path`, and looks how near to `goal` (2,) in W that was."""
    context = simulator.get_mutable_context()
    diagram.GetInputPort("route").FixValue(context, Value(path))
    begun, before = context.get_time(), touches.collisions
    latest = begun + 20.0 + 3.0 * path.length_m / 0.3
    status, off = "", 0.0
    while status != "arrived" and off < 5.0 and context.get_time() < latest:
        simulator.AdvanceTo(context.get_time() + _STEP)
        touches.step(context, truth(diagram, context))
        status = diagram.GetOutputPort("follower.status").Eval(context)
        off = off + _STEP if status == "off the route" else 0.0
    simulator.AdvanceTo(context.get_time() + 0.5)
    there, believed = (
        truth(diagram, context).translation(),
        diagram.GetOutputPort("believed").Eval(context).translation(),
    )
    return Drive(
        error=float(np.hypot(*(there[:2] - goal))),
        touched=touches.collisions - before,
        arrived=status == "arrived",
        pose_error=float(np.hypot(*(there - believed)[:2])),
        time=context.get_time() - begun,
    )


def truth(diagram: Diagram, context: Context) -> RigidTransform:
    """True pose of the base now, a copy: what a port gives changes with the context."""
    return RigidTransform(diagram.GetOutputPort("station.cheat.X_WB").Eval(context))


def learn_route(grid: RouteGrid, pose: np.ndarray, rng: np.random.Generator) -> tuple[Path, np.ndarray, float] | None:
    """A goal far away on the map, and the route that is learnt to it; None when nothing is far enough.

    Returns:
        The route from the free cell nearest to `pose` (3,) [m, m, rad], the goal (2,) [m], and its gap to the optimum.
    """
    nearest = grid.nearest_free(pose[:2])
    if nearest is None:
        return None
    here = grid.centre_of(nearest)
    away = RouteTask(grid, (float(here[0]), float(here[1]))).distance
    open_places = np.isfinite(away) & (grid.clearance >= _ROOM + grid.cell)
    far = np.argwhere(open_places & (away >= max(_FAR, _SHARE * away[open_places].max(initial=0.0))))
    if not len(far):
        return None
    goal = grid.centre_of(far[rng.integers(len(far))])
    task = RouteTask(grid, (float(goal[0]), float(goal[1])))
    start = task.state_of(np.array([*here, pose[2]]))
    learned = learn(task, begin(task, start, seed=int(rng.integers(2**31))))
    driven = roll_out(task, learned.learning.q, start)
    if not driven.reached:
        return None
    xy = driven.poses[:, :2]
    xy = xy[np.append(True, np.linalg.norm(np.diff(xy, axis=0), axis=1) > 1e-9)]
    curve = smooth_path(xy, grid, make_ground(grid, RoutesConfig()), find_islands(grid))
    return Path(xy=curve), goal, learned.gap


def try_yard(seed: int, poses: tuple[str, ...] = POSES) -> dict[str, Any]:
    """Looks around in yard `seed`, learns a route, and drives it by each kind of pose; flat numbers."""
    begun, yard = time.process_time(), build(seed)
    diagram = make_drive(yard.start, yard.world, seed, pose="slam")
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    ability = replace(robot_ability("crawler"), step_threshold=_MAX_STEP)
    touches = TouchCount(diagram, yard.world, ability.footprint)
    ahead = yard.start[:2] + LOOK * np.array([np.cos(yard.start[2]), np.sin(yard.start[2])])
    look = follow(diagram, simulator, Path(xy=np.array([yard.start[:2], ahead])), touches, ahead)
    result: dict[str, Any] = {"seed": seed, "look_time_s": look.time, "look_pose_error_m": look.pose_error}
    cloud = diagram.GetOutputPort("survey_map.map_M").Eval(context)
    keyframes = diagram.GetOutputPort("survey_map.keyframes").Eval(context)
    stood = np.array([keyframe.X_MB.translation()[:2] for keyframe in keyframes])
    learning = time.perf_counter()
    grid = make_route_grid(cloud, ability, VoxelWorldConfig(max_gap=_GAP), stood=stood)
    X_MB = RigidTransform(diagram.GetOutputPort("believed").Eval(context))
    X_WB = truth(diagram, context)
    found = learn_route(grid, planar_pose(X_MB), np.random.default_rng([seed, 7]))
    result["map_and_learning_s"] = time.perf_counter() - learning
    if found is None:
        return result | {"status": "nothing far enough on the map", "cpu_s": time.process_time() - begun}
    path, goal, gap = found
    result |= {
        "status": "driven",
        "way_m": path.length_m,
        "gap": gap,
        "goal_x_m": float(goal[0]),
        "goal_y_m": float(goal[1]),
    }
    # What it does after the look around is the same drive, by what it has believed from then on.
    for pose in poses:
        if pose == "slam":
            drive = follow(diagram, simulator, path, touches, goal)
        else:
            other = make_drive(planar_pose(X_WB), yard.world, seed, pose=pose, X_MB0=X_MB)
            count = TouchCount(other, yard.world, ability.footprint)
            drive = follow(other, Simulator(other), path, count, goal)
        result |= {f"{pose}_{key}": value for key, value in vars(drive).items()}
    return result | {"cpu_s": time.process_time() - begun}


__all__ = ["POSES", "Drive", "make_drive", "try_yard"]
