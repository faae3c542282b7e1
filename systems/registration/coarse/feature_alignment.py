"""The paper's coarse alignment: sample consensus over FPFH features. A named baseline; `find_pose` is ours."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import open3d as o3d
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform, RotationMatrix

from ...config import check_config, quantity

_icp = o3d.pipelines.registration


@dataclass(kw_only=True)
class FeatureAlignmentConfig:
    """How features are made and how a pose is sampled from their matches."""

    # [m] One point a voxel; it sets all lengths below.
    voxel: float = quantity(0.25, unit="m", above=0)
    # [voxels] Radius of the normals and of the features, and neighbours in each at most.
    normal_radius: float = quantity(2.0, unit="voxels", above=0)
    feature_radius: float = quantity(5.0, unit="voxels", above=0)
    normal_neighbours: int = quantity(30, unit="points", low=3)
    feature_neighbours: int = quantity(100, unit="points", low=3)
    # [voxels] A point this near to its partner supports a pose.
    max_distance: float = quantity(1.5, unit="voxels", above=0)
    # [-] Two sampled matches are dropped if their distances in the two clouds differ by more than this ratio.
    edge_similarity: float = quantity(0.9, unit="-", low=0, high=1)
    # [-] Whether matches must be nearest in feature space both ways.
    mutual: bool = True
    # [-] Samples at most, and the certainty at which fewer are enough.
    max_samples: int = quantity(100_000, unit="samples", low=1)
    confidence: float = quantity(0.999, unit="-", above=0, high=1)
    seed: int = quantity(0, unit="-", low=0)


@dataclass(frozen=True, eq=False)
class FeatureAlignment:
    """The result of `align_features`.

    Attributes:
        X_TS: pose of the source in the target; identity when `fitness` is 0.
        fitness: share of the source's voxels with a partner within `max_distance`.
        inlier_rmse: root mean square distance of these [m].
    """

    X_TS: RigidTransform
    fitness: float
    inlier_rmse: float

    def __deepcopy__(self, memo: dict) -> "FeatureAlignment":
        return self


def align_features(
    source: PointCloud, target: PointCloud, config: FeatureAlignmentConfig | None = None
) -> FeatureAlignment:
    """Finds X_TS from matches of fast point feature histograms (FPFH), without a guess.

    S2-b takes FPFH and SAC-IA from PCL (Rusu, Blodow and Beetz, Fast point feature histograms for 3D registration,
    ICRA 2009, sections III and IV). SAC-IA draws a few source points, lets each pick one of the target points with the
    most similar features, makes the pose of these pairs and keeps the one with the least Huber error over all points.
    Open3D's RANSAC is the same but for three things: triples are drawn from matches that are found beforehand (nearest
    in feature space, both ways where `mutual`), a triple whose edges differ is dropped before its pose is made, which
    takes the place of SAC-IA's least distance between samples, and poses are compared by inliers instead of Huber's
    error. With fewer than three usable matches, or an empty cloud, the fitness is 0.
    """
    config = config or FeatureAlignmentConfig()
    check_config(config)
    described = [_describe(cloud, config) for cloud in (source, target)]
    if any(len(cloud.points) < 10 for cloud, _ in described):
        return FeatureAlignment(RigidTransform(), 0.0, float("inf"))
    distance = config.max_distance * config.voxel
    checks = [
        _icp.CorrespondenceCheckerBasedOnEdgeLength(config.edge_similarity),
        _icp.CorrespondenceCheckerBasedOnDistance(distance),
    ]
    o3d.utility.random.seed(config.seed)
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        result = _icp.registration_ransac_based_on_feature_matching(
            described[0][0],
            described[1][0],
            described[0][1],
            described[1][1],
            config.mutual,
            distance,
            _icp.TransformationEstimationPointToPoint(False),
            3,
            checks,
            _icp.RANSACConvergenceCriteria(config.max_samples, config.confidence),
        )
    X = np.asarray(result.transformation)
    if result.fitness <= 0 or not np.isfinite(X).all():
        return FeatureAlignment(RigidTransform(), 0.0, float("inf"))
    X_TS = RigidTransform(RotationMatrix.ProjectToRotationMatrix(X[:3, :3]), X[:3, 3])
    return FeatureAlignment(X_TS, float(result.fitness), float(result.inlier_rmse))


def _describe(cloud: PointCloud, config: FeatureAlignmentConfig) -> tuple[Any, Any]:
    """Thinned points with normals, and their features."""
    points = cloud.point.positions.numpy().astype(float) if "positions" in cloud.point else np.zeros((0, 3))
    points = points[np.isfinite(points).all(axis=1)]
    thinned = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)).voxel_down_sample(config.voxel)
    if len(thinned.points) == 0:
        return thinned, None
    search = o3d.geometry.KDTreeSearchParamHybrid
    thinned.estimate_normals(search(config.normal_radius * config.voxel, config.normal_neighbours))
    # Seen from the sensor, so that both clouds agree on their signs.
    thinned.orient_normals_towards_camera_location(np.zeros(3))
    radius = config.feature_radius * config.voxel
    return thinned, _icp.compute_fpfh_feature(thinned, search(radius, config.feature_neighbours))
