"""A floor with a pool, traps for its detection, what a LiDAR that drives by sees of them, and a map made of them."""

import numpy as np
import open3d as o3d
from naraha.systems.clouds import voxel_filter
from naraha.systems.sensing import LidarConfig, Scan, Surface, SurfaceTable, vlp16
from naraha.systems.sensing.lidar import make_cloud, simulate_returns, sweep_rays
from open3d.t.geometry import PointCloud
from pydrake.geometry import Box, Cylinder
from pydrake.math import RigidTransform, RollPitchYaw

POOL, RADIUS = np.array([3.0, 1.2]), 0.4
MAT, PANEL, CORNER = np.array([3.0, -1.2]), np.array([4.2, 0.0]), np.array([1.5, -2.2])
SENSOR_HEIGHT = 0.3
PATTERN = vlp16()
SURFACES = SurfaceTable(
    by_pattern={
        "pool": Surface(lidar_reflectivity=0.02, nir_reflectance=0.02, specular=0.98),
        "mat": Surface(lidar_reflectivity=0.05, nir_reflectance=0.05),
        "panel": Surface(lidar_reflectivity=0.05, nir_reflectance=0.05),
        "wall_1": Surface(lidar_reflectivity=0.2, nir_reflectance=0.04),
        "*": Surface(lidar_reflectivity=0.35, nir_reflectance=0.35),
    }
)
WALLS = [((7, 0), (0.1, 8)), ((-3, 0), (0.1, 8)), ((2, 4), (10, 0.1)), ((2, -4), (10, 0.1))]


def hall_scene(world, extra=()):
    """The hall as a `RayScene`; `extra` are further (shape, place, name)."""
    world.add(Box(10, 8, 0.1), (2, 0, -0.05), "floor")
    world.add(Cylinder(RADIUS, 0.1), (*POOL, -0.045), "pool").add(Box(0.8, 0.8, 0.1), (*MAT, -0.045), "mat")
    world.add(Box(0.05, 0.8, 1.0), (*PANEL, 0.5), "panel")
    for i, ((x, y), (a, b)) in enumerate(WALLS):
        world.add(Box(a, b, 2), (x, y, 1), f"wall_{i + 1}")
    for shape, place, name in extra:
        world.add(shape, place, name)
    return world.rays(SURFACES)


def sensor_pose(x, y=0.0, yaw=0.0, pitch=0.0):
    return RigidTransform(RollPitchYaw(0, pitch, yaw), [x, y, SENSOR_HEIGHT])


def scan_between(scene, X_WS0, X_WS1, index=0, *, start_time=0.0, mirror=True, own_distance=None):
    """The scan of a sensor that moves from one pose to the other in 0.1 s."""
    rays = sweep_rays(PATTERN, X_WS0.GetAsMatrix4(), X_WS1.GetAsMatrix4())
    rng = np.random.default_rng(index)
    config = LidarConfig(mirror=mirror)
    returns = simulate_returns(*rays, scene, rng, config=config, pattern=PATTERN, own_distance=own_distance)
    return Scan(make_cloud(PATTERN, returns), start_time, start_time + 0.1, index)


def hall_map(seed=0, eye=(0.0, 0.0, 0.56)):
    """A voxel map of 0.1 m with what cameras at `eye` measure, and which of its points are water.

    Light of the lamp falls with the square of the distance and the noise of the brightness does not, so the error of
    `nir` grows with it. The corner by the wall lies in shadow.
    """
    rng = np.random.default_rng(seed)
    parts = []
    floor = rng.uniform([-3, -4], [7, 4], (40_000, 2))
    water = np.hypot(*(floor - POOL).T) < RADIUS
    nir = np.where(np.abs(floor - MAT).max(axis=1) < 0.4, 0.05, 0.35)
    nir = np.where(np.abs(floor - CORNER).max(axis=1) < 0.4, 0.02, nir)
    nir = np.where(water, 0.02, nir)
    parts.append((np.column_stack([floor, np.zeros(len(floor))]), nir, np.zeros(len(floor)), water))
    uprights = [(centre, size, 2.0, 0.04 if i == 0 else 0.45) for i, (centre, size) in enumerate(WALLS)]
    for (x, y), (a, b), height, value in [*uprights, (PANEL, (0.05, 0.8), 1.0, 0.05)]:
        count = int(500 * max(a, b) * height)
        side = rng.uniform([x - a / 2, y - b / 2, 0], [x + a / 2, y + b / 2, height], (count, 3))
        parts.append((side, np.full(count, value), np.full(count, np.pi / 2), np.zeros(count, bool)))
    points, nir, tilt, water = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    away = np.linalg.norm(points - eye, axis=1)
    points[:, 2] += rng.normal(0, 0.008, len(points))
    nir = np.clip(nir + rng.normal(0, 0.006, len(nir)) * away**2, 0, 1)
    tilt = np.abs(tilt + rng.normal(0, 0.08, len(tilt)))
    cloud = PointCloud(o3d.core.Tensor(points.astype(np.float32)))
    for name, values in {"nir": nir, "nir_range": away, "tilt": tilt, "truth": water}.items():
        cloud.point[name] = o3d.core.Tensor(values.astype(np.float32)[:, None])
    cloud = voxel_filter(cloud, 0.1)
    return cloud, cloud.point["truth"].numpy()[:, 0] > 0.5


def iou(found, truth):
    return np.sum(found & truth) / max(np.sum(found | truth), 1)
