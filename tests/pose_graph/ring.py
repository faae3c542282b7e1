"""A square corridor of boxes, and a robot that goes round in it with odometry that drifts."""

import numpy as np
import open3d as o3d
from naraha.systems.clouds import voxel_filter
from naraha.systems.slam import Keyframe
from pydrake.math import RigidTransform, RollPitchYaw

from tests.rooms import make_cloud, pose

# Walls of the ring, floor, ceiling, and what stands in it: centre and size [m].
BOXES = [
    ([0, 0, -0.05], [16, 16, 0.1]),
    ([0, 0, 2.55], [16, 16, 0.1]),
    *[([8.05 * s, 0, 1.25], [0.1, 16.2, 2.5]) for s in (-1, 1)],
    *[([0, 8.05 * s, 1.25], [16.2, 0.1, 2.5]) for s in (-1, 1)],
    ([0, 0, 1.25], [10, 10, 2.5]),
    ([-7.6, -3.0, 0.6], [0.8, 1.0, 1.2]),
    ([-5.3, 2.5, 0.8], [0.6, 0.4, 1.6]),
    ([2.0, -7.7, 1.0], [1.5, 0.6, 2.0]),
    ([-3.5, -7.7, 0.4], [0.5, 0.6, 0.8]),
    ([7.6, -1.0, 0.7], [0.8, 0.8, 1.4]),
    ([7.8, 4.0, 1.0], [0.4, 1.6, 2.0]),
    ([-1.0, 7.7, 0.5], [2.0, 0.6, 1.0]),
    ([4.0, 5.3, 1.0], [0.4, 0.6, 2.0]),
]
SIDE = 13.0  # [m] of the robot's way
STEPS = 9  # on each side


def scene():
    casting = o3d.t.geometry.RaycastingScene()
    for centre, size in BOXES:
        box = o3d.t.geometry.TriangleMesh.create_box(*size)
        casting.add_triangles(box.translate(np.array(centre, np.float32) - np.array(size, np.float32) / 2))
    return casting


def scan(casting, X_MB, rng):
    """Points in B that a LiDAR of 16 lines sees, 0.8 m above the base, with noise of 1 cm."""
    azimuth, elevation = np.meshgrid(np.deg2rad(np.arange(0, 360, 1.0)), np.deg2rad(np.arange(-24, 25, 3.2)))
    d_B = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], -1
    ).reshape(-1, 3)
    origin = X_MB.multiply(np.array([0, 0, 0.8]))
    rays = np.hstack([np.broadcast_to(origin, d_B.shape), d_B @ X_MB.rotation().matrix().T]).astype(np.float32)
    distance = casting.cast_rays(o3d.core.Tensor(rays), nthreads=1)["t_hit"].numpy().astype(float)
    hit = np.isfinite(distance)
    distance = distance[hit] + rng.normal(0, 0.01, hit.sum())
    return voxel_filter(make_cloud([0, 0, 0.8] + distance[:, None] * d_B[hit]), 0.1)


def true_poses(extra=4):
    """Once round the ring, and on over the first `extra` steps again."""
    poses = []
    for k in range(4 * STEPS + extra):
        side, step = divmod(k % (4 * STEPS), STEPS)
        along = SIDE * (step / STEPS - 0.5)
        turned = RigidTransform(RollPitchYaw(0, 0, side * np.pi / 2), np.zeros(3))
        poses.append(turned @ pose(along, -SIDE / 2, 0.0))
    return poses


def drive(seed=0, yaw_drift=0.004, slip=0.02, extra=4):
    """Keyframes whose steps turn and stretch a little too much, and the true poses."""
    rng, casting, truth = np.random.default_rng(seed), scene(), true_poses(extra)
    keyframes, X_MB = [], truth[0]
    for k, true in enumerate(truth):
        X_PB = None
        if k:
            step = truth[k - 1].inverse() @ true
            X_PB = RigidTransform(
                step.rotation() @ RollPitchYaw(0, 0, yaw_drift).ToRotationMatrix(), (1 + slip) * step.translation()
            )
            X_MB = X_MB @ X_PB
        covariance = np.diag(np.square([0.002, 0.002, 0.01, 0.05, 0.05, 0.01]))
        keyframes.append(Keyframe(k, 0.1 * k, X_MB, None, scan(casting, true, rng), 1.0, X_PB, covariance))
    return keyframes, truth
