"""Open3D's ICP, as a baseline."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import open3d as o3d
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform, RotationMatrix

from ..clouds import estimate_normals, transform_points, voxel_filter
from .alignment import Alignment, nothing_found, point_alignment
from .config import RegistrationConfig
from .surfels import usable_points

_icp = o3d.pipelines.registration


@dataclass(frozen=True, eq=False)
class IcpPoints:
    """Points in Open3D's older type: in 0.19 its ICP is ten times as fast as that of the tensor clouds. Of a target,
    normals (N, 3) too."""

    cloud: Any
    normals: np.ndarray

    def __len__(self) -> int:
        return len(self.cloud.points)


def prepare_icp(cloud: PointCloud, config: RegistrationConfig) -> IcpPoints:
    """The points of a cloud that is to be registered, thinned."""
    if config.icp.source_voxel > 0:
        cloud = voxel_filter(PointCloud(cloud.point.positions), config.icp.source_voxel)
    return IcpPoints(_legacy(cloud.point.positions.numpy()[usable_points(cloud)]), np.zeros((0, 3)))


def prepare_icp_target(cloud: PointCloud, config: RegistrationConfig) -> IcpPoints:
    """Those of a cloud that others will be registered to, with its own normals or with estimated ones."""
    usable = usable_points(cloud)
    points = cloud.point.positions.numpy()[usable]
    if "normals" in cloud.point:
        normals = cloud.point.normals.numpy()[usable].astype(float)
    else:
        normals = estimate_normals(points, config.icp.normal_radius)
    target = IcpPoints(_legacy(points), normals)
    if config.method == "point_to_plane":
        target.cloud.normals = o3d.utility.Vector3dVector(normals)
    return target


def align_icp(source: IcpPoints, target: IcpPoints, X_TS: RigidTransform, config: RegistrationConfig) -> Alignment:
    """Lays the source on the target with Open3D's ICP, from coarse to fine correspondence distances.

    Method `point_to_point` minimises E = Σ |p_k − (R q + T)|² (S0-g, Eq. 7). The result is rounded to 1e-6 m and
    1e-6 rad because Open3D adds in the order in which its threads finish: without it two runs differ in the last bits.
    """
    c, X = config.icp, X_TS.GetAsMatrix4()
    criteria = _icp.ICPConvergenceCriteria(1e-6, 1e-6, c.max_iterations)
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        for distance in c.max_distances:
            if config.method == "generalized":
                estimation = _icp.TransformationEstimationForGeneralizedICP()
                step = _icp.registration_generalized_icp(source.cloud, target.cloud, distance, X, estimation, criteria)
            else:
                estimation = _estimation(config, distance)
                step = _icp.registration_icp(source.cloud, target.cloud, distance, X, estimation, criteria)
            X = step.transformation
        result = _icp.evaluate_registration(source.cloud, target.cloud, config.inlier_distance, X)
    # The set of pairs is always the same, its order is not.
    pairs = np.asarray(result.correspondence_set).reshape(-1, 2)
    pairs = pairs[np.argsort(pairs[:, 0])]
    if len(pairs) == 0 or not np.isfinite(result.transformation).all():
        return nothing_found(X_TS)
    X_TS = _rounded_pose(result.transformation)
    p_TS = transform_points(X_TS.GetAsMatrix4(), np.asarray(source.cloud.points)[pairs[:, 0]])
    p_TT = np.asarray(target.cloud.points)[pairs[:, 1]]
    return point_alignment(X_TS, len(source), p_TS, p_TT, target.normals[pairs[:, 1]])


def _legacy(points: np.ndarray) -> Any:
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(float)))


def _estimation(config: RegistrationConfig, distance: float) -> Any:
    if config.method == "point_to_point":
        return _icp.TransformationEstimationPointToPoint()
    width = config.icp.kernel_scale * distance
    kernels = {"none": _icp.L2Loss, "tukey": lambda: _icp.TukeyLoss(width), "geman_mcclure": lambda: _icp.GMLoss(width)}
    return _icp.TransformationEstimationPointToPlane(kernels[config.icp.kernel]())


def _rounded_pose(X: np.ndarray) -> RigidTransform:
    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(np.round(X[:3, :3], 6)), np.round(X[:3, 3], 6))
