"""A room and a corridor in closed form, and what a sensor in them sees."""

import numpy as np
import open3d as o3d
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform, RollPitchYaw

# Centre, size of each box [m]. The first is the room, seen from inside; no motion maps the whole to itself.
BOXES = [([0, 0, 1.5], [10, 8, 3]), ([3, -2, 0.75], [1.0, 2.0, 1.5]), ([-2, 3, 1.0], [2.0, 0.6, 2.0])]
NOISE = 0.005  # [m]


def pose(x=0.0, y=0.0, z=1.0, roll=0.0, pitch=0.0, yaw=0.0):
    return RigidTransform(RollPitchYaw(roll, pitch, yaw), [x, y, z])


def make_cloud(points):
    return PointCloud(o3d.core.Tensor(np.asarray(points, np.float32)))


def room_points(rng, count):
    """Points on the faces of `BOXES`, as many on each square metre."""
    faces = [
        (np.array(c, float), np.array(s, float), axis, sign) for c, s in BOXES for axis in range(3) for sign in (-1, 1)
    ]
    areas = np.array([np.prod(np.delete(size, axis)) for _, size, axis, _ in faces])
    points = []
    for (centre, size, axis, sign), share in zip(faces, areas / areas.sum(), strict=True):
        p = rng.uniform(-0.5, 0.5, (int(share * count), 3)) * size
        p[:, axis] = 0.5 * sign * size[axis]
        points.append(centre + p)
    return np.vstack(points)


def room_scan(rng, X_WS, count=6000):
    """The points of the room in the sensor frame, with noise; nothing hides anything."""
    p_WP = room_points(rng, count)
    return X_WS.inverse().multiply(p_WP.T).T + rng.normal(0, NOISE, p_WP.shape)


def corridor(rng, count, length=30.0):
    """Points on floor, walls and ceiling of a square corridor along x, 2.4 m wide, without ends."""
    x, u = rng.uniform(-length / 2, length / 2, count), rng.uniform(-1.2, 1.2, count)
    side, sign = rng.integers(0, 2, count), rng.choice([-1.2, 1.2], count)
    return np.stack([x, np.where(side, sign, u), np.where(side, u, sign)], axis=1)
