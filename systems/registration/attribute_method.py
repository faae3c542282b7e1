"""Attribute ICP (S2-c) as one of the methods of registration."""

from dataclasses import dataclass

import numpy as np
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform
from scipy.spatial import KDTree

from ..clouds import estimate_normals, transform_points, voxel_filter
from .alignment import Alignment, point_alignment
from .attribute_icp import attribute_icp
from .config import RegistrationConfig
from .surfels import usable_points


@dataclass(frozen=True, eq=False)
class AttributePoints:
    """Points (N, 3) and the ids of their classes (N,); 0 without classes. Of a target, normals (N, 3) too."""

    points: np.ndarray
    classes: np.ndarray
    normals: np.ndarray

    def __len__(self) -> int:
        return len(self.points)


def prepare_attributes(cloud: PointCloud, config: RegistrationConfig) -> AttributePoints:
    """The points of a cloud that is to be registered, thinned, and what their classes are most probably."""
    points = PointCloud(cloud.point.positions)
    if "class_probabilities" in cloud.point:
        points.point["class_probabilities"] = cloud.point["class_probabilities"]
    if config.icp.source_voxel > 0:
        points = voxel_filter(points, config.icp.source_voxel)
    usable = usable_points(points)
    classes = np.zeros(len(usable), int)
    if "class_probabilities" in points.point:
        classes = np.nan_to_num(points.point["class_probabilities"].numpy()[usable]).argmax(axis=1)
    return AttributePoints(points.point.positions.numpy()[usable].astype(float), classes, np.zeros((0, 3)))


def prepare_attribute_target(cloud: PointCloud, config: RegistrationConfig) -> AttributePoints:
    """Those of a cloud that others will be registered to, with normals, which only the verdict needs."""
    target = prepare_attributes(cloud, config)
    return AttributePoints(target.points, target.classes, estimate_normals(target.points, config.icp.normal_radius))


def align_attributes(
    source: AttributePoints, target: AttributePoints, X_TS: RigidTransform, config: RegistrationConfig
) -> Alignment:
    """Lays the source on the target by attribute ICP, starting at the pose X_TS."""
    X_TS = attribute_icp(source.points, source.classes, target.points, target.classes, X_TS, config.attributes).X_TS
    p_TS = transform_points(X_TS.GetAsMatrix4(), source.points)
    distance, nearest = KDTree(target.points).query(p_TS, distance_upper_bound=config.inlier_distance)
    found = np.isfinite(distance)
    return point_alignment(
        X_TS, len(source), p_TS[found], target.points[nearest[found]], target.normals[nearest[found]]
    )
