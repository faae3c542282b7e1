"""Views of the simulated worlds as a VLP-16 at rest takes them, far apart."""

import numpy as np
import open3d as o3d
from naraha.models.worlds import load_world
from naraha.systems.sensing import scan_at
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform, RollPitchYaw

PLACES = [(-8.0, -5.0), (4.0, -4.6), (7.2, 3.0), (-1.0, -3.0), (-8.0, 2.0)]
HEIGHT = 0.30  # [m] of the sensor over the floor


def take_views(seed, *, world="stair_hall", places=PLACES, revolutions=5, tilt_deg=0.3, lean_deg=0.0):
    """Clouds of `revolutions` in a levelled frame V, and the true X_WV.

    Yaw is random; the levelling is off by a random roll and pitch of `tilt_deg`. With `lean_deg` the sensor leans that
    much, and clouds are in its own frame: a third result is what the IMU says, roll and pitch with the same error.
    """
    rng = np.random.default_rng([seed, 7])
    scene = load_world(world, seed).ray_scene()
    clouds, poses, angles = [], [], []
    for place in places:
        x, y = _free(scene, place)
        roll, pitch = np.deg2rad(lean_deg) * rng.uniform(-1, 1, 2)
        X_WS = RigidTransform(RollPitchYaw(roll, pitch, rng.uniform(-np.pi, np.pi)), [x, y, HEIGHT])
        shots = [scan_at(scene, X_WS, rng) for _ in range(revolutions)]
        points = np.vstack([shot.point.positions.numpy() for shot in shots])
        error = np.deg2rad(tilt_deg) * rng.standard_normal(2)
        X_VS = RigidTransform()
        if lean_deg == 0:
            X_VS = RigidTransform(RollPitchYaw(*error, 0), [0, 0, 0])
        cloud = cloud_of(points @ X_VS.rotation().matrix().T)
        cloud.point["intensity"] = o3d.core.Tensor(np.vstack([shot.point.intensity.numpy() for shot in shots]))
        clouds.append(cloud)
        poses.append(X_WS @ X_VS.inverse())
        angles.append(np.array([roll + error[0], pitch + error[1], 0.0]))
    return clouds, poses, angles


def _free(scene, place):
    """The place, or the nearest one 0.6 m clear of everything at the height of the sensor: no sensor is in a crate."""
    steps = np.array([(x, y) for x in np.arange(-2, 2.1, 0.25) for y in np.arange(-2, 2.1, 0.25)])
    steps = steps[np.argsort(np.linalg.norm(steps, axis=1), kind="stable")] + place
    at = np.column_stack([steps, np.full(len(steps), 0.65)])
    return steps[np.argmax(scene.distance_to_surface(at) > 0.6)]


def cloud_of(points):
    return PointCloud(np.ascontiguousarray(points, np.float32))


def errors(X_est, X_true):
    """Distance [m] and angle [deg] between two poses."""
    E = X_true.inverse() @ X_est
    return float(np.linalg.norm(E.translation())), float(np.rad2deg(abs(E.rotation().ToAngleAxis().angle())))


def box_room(rng, count=40000, *, p=(0.0, 0.0), yaw=0.0, crate=False):
    """Floor and walls of an empty room of 10 × 6 m, which fits itself turned by 180°, seen from p at 0.3 m height."""
    half = np.array([5.0, 3.0])
    u, side = rng.uniform(-1, 1, (count, 2)), rng.integers(0, 5, count)
    points = np.column_stack([u * half, np.zeros(count)])
    for axis in range(2):
        for sign in (-1, 1):
            wall = side == 1 + 2 * axis + (sign > 0)
            points[wall, axis] = sign * half[axis]
            points[wall, 2] = rng.uniform(0, 2.5, int(wall.sum()))
    if crate:
        box = rng.uniform(-1, 1, (count // 6, 3)) * 0.5
        face = rng.integers(0, 3, len(box))
        box[np.arange(len(box)), face] = 0.5 * np.sign(box[np.arange(len(box)), face])
        points = np.vstack([points, box + np.array([3.5, 1.5, 0.5])])
    X_WS = RigidTransform(RollPitchYaw(0, 0, yaw), [*p, HEIGHT])
    return X_WS.inverse().multiply(points.T).T + rng.normal(0, 0.005, points.shape), X_WS
