"""What a spinning LiDAR sees of boxes: rays and boxes in closed form, organised as a range image."""

import numpy as np
import open3d as o3d
from naraha.systems.sensing import ScanPattern, vlp16
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform

from tests.rooms import BOXES, NOISE

# Centre, size [m], turn about z [rad]. A bare corridor along x whose ends are out of sight, and a room with furniture.
CORRIDOR = [([0, 0, 1.3], [200.0, 3.0, 2.6], 0.0)]
ROOM = [(centre, size, 0.0) for centre, size in BOXES] + [
    ([-3.5, -2.5, 0.5], [1.2, 1.8, 1.0], 0.5),
    ([0.5, 2.8, 0.75], [1.5, 0.8, 1.5], -0.3),
    ([3.6, 2.4, 0.6], [0.9, 1.4, 1.2], 1.0),
    ([-0.5, -3.2, 0.9], [0.8, 0.8, 1.8], 0.8),
]


def cast(boxes, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Distance (N,) along unit `directions` (N, 3) to the first face; the first box is seen from inside."""
    nearest = np.full(len(origins), np.inf)
    for i, (centre, size, yaw) in enumerate(boxes):
        R = np.array([[np.cos(yaw), np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        o, d = (origins - centre) @ R.T, directions @ R.T
        with np.errstate(divide="ignore"):
            t = np.stack([(sign * 0.5 * np.array(size) - o) / d for sign in (-1, 1)])
        enter, leave = t.min(axis=0).max(axis=1), t.max(axis=0).min(axis=1)
        hit = leave if i == 0 else np.where((enter < leave) & (enter > 0), enter, np.inf)
        nearest = np.minimum(nearest, hit)
    return nearest


def scan(
    boxes,
    X_WS: RigidTransform,
    rng: np.random.Generator,
    *,
    noise: float = NOISE,
    pattern: ScanPattern | None = None,
    max_range: float = 30.0,
    organised: bool = True,
) -> PointCloud:
    """The returns in the sensor's frame, with rings and columns when `organised`."""
    pattern = pattern or vlp16()
    R, p = X_WS.rotation().matrix(), X_WS.translation()
    origins, directions = pattern.p_SR.astype(float), pattern.d_S.astype(float)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ranges = cast(boxes, origins @ R.T + p, directions @ R.T)
    hit = ranges < max_range
    ranges = ranges + rng.normal(0, noise, len(ranges))
    cloud = PointCloud(o3d.core.Tensor((origins + directions * ranges[:, None])[hit].astype(np.float32)))
    if organised:
        cloud.point["ring"] = o3d.core.Tensor(np.ascontiguousarray(pattern.ring[hit][:, None]))
        cloud.point["column"] = o3d.core.Tensor(np.ascontiguousarray(pattern.column[hit][:, None]))
    return cloud


def spots(p_WP: np.ndarray) -> np.ndarray:
    """Class 1 in spots of the corridor's floor and walls (water, paint), class 0 elsewhere, (N,)."""
    rng = np.random.default_rng(0)
    classes = np.zeros(len(p_WP), int)
    for x in np.arange(-30, 30, 1.7):
        centre = np.array([x + rng.uniform(-0.8, 0.8), rng.choice([-1.5, 0.0, 1.5]), 0.0])
        centre[2] = 0.0 if centre[1] == 0 else rng.uniform(0.5, 1.5)
        classes[np.linalg.norm(p_WP - centre, axis=1) < rng.uniform(0.3, 0.6)] = 1
    return classes


def with_classes(
    cloud: PointCloud, X_WS: RigidTransform, rng: np.random.Generator, *, wrong: float = 0.0
) -> PointCloud:
    """The cloud with probabilities of the classes of `spots`, of which the part `wrong` is the other way round."""
    points = cloud.point.positions.numpy().astype(float)
    classes = spots(X_WS.multiply(points.T).T) ^ (rng.random(len(points)) < wrong)
    sure = 1 - max(wrong, 0.02)
    probabilities = np.where(classes[:, None] == [0, 1], sure, 1 - sure)
    cloud.point["class_probabilities"] = o3d.core.Tensor(probabilities.astype(np.float32))
    return cloud
