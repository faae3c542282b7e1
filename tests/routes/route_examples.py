"""Running examples of the systems that offer, draw and drive routes."""

import numpy as np
import open3d as o3d
from naraha.systems.display import RouteDisplay
from naraha.systems.drive import ModeSwitch, MotionPrimitives
from naraha.systems.routes import DistinctRoutes, PolicyLookup, RoutePolicy, RouteTask, VoxelWorld, find_routes, solve
from naraha.systems.slam import Keyframe
from naraha.systems.tracking import PathFollower
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.framework import DiagramBuilder, LeafSystem, System
from pydrake.systems.primitives import ConstantValueSource, ConstantVectorSource

from .maps import water_map


def with_inputs(system: LeafSystem, **inputs: object) -> tuple[System, LeafSystem]:
    """A diagram of `system` and constant sources for its inputs: arrays on vector ports, all else abstract."""
    builder = DiagramBuilder()
    builder.AddSystem(system)
    for name, value in inputs.items():
        vector = isinstance(value, np.ndarray)
        source = ConstantVectorSource(value) if vector else ConstantValueSource(AbstractValue.Make(value))
        builder.Connect(builder.AddSystem(source).get_output_port(), system.GetInputPort(name))
    return builder.Build(), system


def floor_with_pool(seed: int = 0, spacing: float = 0.05) -> PointCloud:
    """Points of a floor of 8 × 6 m with walls around it and a pool of 0.8 m diameter in the middle, with `label`."""
    rng = np.random.default_rng(seed)
    x, y = np.arange(-4, 4, spacing), np.arange(-3, 3, spacing)
    flat = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    floor = np.column_stack([flat, rng.normal(0, 0.003, len(flat))])
    walls = []
    for along, half in ((0, 3.0), (1, 4.0)):
        for side in (-half, half):
            s, z = np.meshgrid((x, y)[along], np.arange(0, 1.5, spacing), indexing="ij")
            wall = np.full((s.size, 3), side)
            wall[:, along], wall[:, 2] = s.ravel(), z.ravel()
            walls.append(wall)
    points = np.vstack([floor, *walls]).astype(np.float32)
    water = (np.hypot(points[:, 0], points[:, 1]) < 0.4) & (points[:, 2] < 0.1)
    cloud = PointCloud(o3d.core.Tensor(points))
    cloud.point["label"] = o3d.core.Tensor(water.astype(np.uint8)[:, None])
    return cloud


def distinct_routes(seed: int) -> tuple[System, LeafSystem]:
    grid, start, goal = water_map(seed)
    return with_inputs(DistinctRoutes(), route_grid=grid, start=start, goal=np.array(goal))


def voxel_world(seed: int) -> tuple[System, LeafSystem]:
    cloud = floor_with_pool(seed)
    keyframe = Keyframe(0, 0.0, RigidTransform([-3, 0, 0.2]), None, cloud, 0.0)
    return with_inputs(VoxelWorld(), semantic_M=cloud, keyframes=(keyframe,))


def path_follower(seed: int) -> tuple[System, LeafSystem]:
    grid, start, goal = water_map(seed)
    route = find_routes(grid, start, np.array(goal))[0]
    return with_inputs(PathFollower(), route=route, X_MB=RigidTransform([*start[:2], 0.1]))


def route_display(seed: int) -> tuple[System, LeafSystem]:
    grid, start, goal = water_map(seed)
    routes = find_routes(grid, start, np.array(goal))
    return with_inputs(RouteDisplay(meshcat=Meshcat()), routes=routes, chosen=np.array([0.0]))


def mode_switch(seed: int) -> tuple[System, LeafSystem]:
    twist = np.random.default_rng(seed).uniform(-0.2, 0.2, 2)
    return with_inputs(
        ModeSwitch(),
        mode_command="teleoperation",
        autonomous_twist=np.zeros(2),
        teleoperation_twist=twist,
        teleoperation_time=np.zeros(1),
    )


def motion_primitives(seed: int) -> tuple[System, LeafSystem]:
    """A robot that does not move, told to turn left."""
    return with_inputs(MotionPrimitives(), action=np.array([2.0]), X_MB=RigidTransform([seed, 0, 0.1]))


def policy_lookup(seed: int) -> tuple[System, LeafSystem]:
    grid, start, goal = water_map(seed)
    task = RouteTask(grid, goal)
    policy = RoutePolicy.of(task, solve(task).q)
    return with_inputs(PolicyLookup(), policy=policy, X_MB=RigidTransform([*start[:2], 0.1]))


ROUTE_EXAMPLES = {
    "DistinctRoutes": distinct_routes,
    "ModeSwitch": mode_switch,
    "MotionPrimitives": motion_primitives,
    "PathFollower": path_follower,
    "PolicyLookup": policy_lookup,
    "RouteDisplay": route_display,
    "VoxelWorld": voxel_world,
}
