"""Registration of two point clouds with Open3D's ICP, with a verdict on whether the answer can be used."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import open3d as o3d
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from ..clouds import estimate_normals, transform_points, voxel_filter
from ..config import quantity
from .constraint import AXES, constraint, undo_unheld_motion

_icp = o3d.pipelines.registration
METHODS = ("point_to_point", "point_to_plane", "generalized")
KERNELS = ("none", "tukey", "geman_mcclure")


@dataclass(kw_only=True)
class RegistrationConfig:
    """How one cloud is registered to another, and when the result is believed."""

    # `point_to_point` is S0-g, Eq. 7; `point_to_plane` needs fewer points a surface; `generalized` is GICP.
    method: str = quantity("point_to_plane", choices=METHODS)
    # Loss on the residual of `point_to_plane`; "tukey" cuts off what moved or was not there before.
    kernel: str = quantity("tukey", choices=KERNELS)
    # [-] Width of the kernel as a part of the correspondence distance of each stage.
    kernel_scale: float = quantity(0.5, unit="-", above=0)
    # [m] Correspondence distance of each stage, coarse to fine: the first bounds the error of the guess that can be
    # corrected, the last the influence of what only one cloud saw.
    max_distances: list[float] = quantity([2.0, 1.0, 0.5], unit="m", above=0)
    # [-] Iterations of each stage at most.
    max_iterations: int = quantity(30, unit="iterations", low=1)
    # [m] The source is thinned to one point a voxel, for speed; 0 keeps all.
    source_voxel: float = quantity(0.4, unit="m", low=0)
    # [m] Radius in which the normals of a target without normals are estimated.
    normal_radius: float = quantity(0.75, unit="m", above=0)
    # [m] A source point with a target point this near counts as inlier.
    inlier_distance: float = quantity(0.3, unit="m", above=0)
    # [-] Smallest part of the source that must be inliers.
    min_fitness: float = quantity(0.5, unit="-", low=0, high=1)
    # [points] Smallest number of points in either cloud, and of inliers.
    min_points: int = quantity(100, unit="points", low=6)
    # [-] A motion of which the surfaces feel less than this part, see `constraint`, is taken from the guess. A VLP-16
    # in a hall of 20 m has 0.02 to 0.04, because few of its rays meet the floor.
    min_constraint: float = quantity(0.003, unit="-", low=0, high=1)
    # [m], [deg] Largest correction of the guess; more is taken for a wrong match.
    max_correction: float = quantity(2.0, unit="m", above=0)
    max_correction_deg: float = quantity(60.0, unit="deg", above=0, high=180)
    # [deg] Turns about the source's z axis, from which it is tried again when fitness is below `retry_fitness`.
    retry_yaws_deg: list[float] = quantity([-40.0, -20.0, 20.0, 40.0], unit="deg", low=-180, high=180)
    # [-] 0 never tries again.
    retry_fitness: float = quantity(0.85, unit="-", low=0, high=1)


# With this much constraint in its weakest direction, the health of a registration is its fitness.
GOOD_CONSTRAINT = 0.03


@dataclass(frozen=True, eq=False)
class Registration:
    """The result of `register`.

    Attributes:
        X_TS: pose of the source in the target; the guess when `valid` is False.
        fitness: part of the (thinned) source points that are inliers, [0, 1]; 0 when it is not valid.
        inlier_rmse: root mean square distance of the inliers to their partners [m]; inf when it is not valid.
        inliers: number of them.
        health: [0, 1]; fitness times how well the geometry holds the motion that it holds least.
        valid: whether `X_TS` may be used.
        reason: why it is not valid, or which motions were taken from the guess; else "".
    """

    X_TS: RigidTransform
    fitness: float
    inlier_rmse: float
    inliers: int
    health: float
    valid: bool
    reason: str

    def __deepcopy__(self, memo: dict) -> "Registration":
        return self


def register(
    source: PointCloud, target: PointCloud, X_TS_guess: RigidTransform, config: RegistrationConfig | None = None
) -> Registration:
    """Finds the pose X_TS that lays `source` (points in S) on `target` (points in T), starting at the guess.

    Method `point_to_point` minimises E = Σ |p_k − (R q + T)|² (S0-g, Eq. 7). All methods run from coarse to fine
    correspondence distances and end in the same checks; nothing here raises, and what fails returns the guess,
    `valid` False and the reason. The result is rounded to 1e-6 m and 1e-6 rad because Open3D adds in the order in
    which its threads finish: without it two runs differ in the last bits.
    """
    config = config or RegistrationConfig()
    finite_guess = bool(np.isfinite(X_TS_guess.GetAsMatrix34()).all())
    if not finite_guess:
        return _rejected(RigidTransform(), "the guess is not finite")
    p_SP, p_TQ = _finite_points(source), _finite_points(target)
    for name, points in (("source", p_SP), ("target", p_TQ)):
        if len(points) < config.min_points:
            return _rejected(X_TS_guess, f"{name} has {len(points)} usable points, needs {config.min_points}")
    if config.source_voxel > 0:
        p_SP = _finite_points(voxel_filter(PointCloud(o3d.core.Tensor(p_SP)), config.source_voxel))
        if len(p_SP) < config.min_points:
            return _rejected(X_TS_guess, f"source covers {len(p_SP)} voxels, needs {config.min_points}")
    normals = _normals(target, p_TQ, config.normal_radius)
    source_cloud, target_cloud = _legacy(p_SP), _legacy(p_TQ)
    if config.method == "point_to_plane":
        target_cloud.normals = o3d.utility.Vector3dVector(normals)

    best = _align(source_cloud, target_cloud, X_TS_guess.GetAsMatrix4(), config)
    if best.fitness < config.retry_fitness:
        for yaw in config.retry_yaws_deg:
            X_turned = X_TS_guess @ RigidTransform(RollPitchYaw(0, 0, np.deg2rad(yaw)), np.zeros(3))
            again = _align(source_cloud, target_cloud, X_turned.GetAsMatrix4(), config)
            if again.fitness > best.fitness:
                best = again
    return _judge(best, p_SP, normals, X_TS_guess, config)


def _finite_points(cloud: PointCloud) -> np.ndarray:
    if "positions" not in cloud.point:
        return np.zeros((0, 3), np.float32)
    points = cloud.point.positions.numpy()
    return points[np.isfinite(points).all(axis=1)]


def _legacy(points: np.ndarray) -> Any:
    """Open3D's older cloud type: in 0.19 its ICP is ten times as fast as that of the tensor clouds."""
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(float)))


def _normals(target: PointCloud, points: np.ndarray, radius: float) -> np.ndarray:
    if "normals" in target.point and len(target.point.normals) == len(points):
        return target.point.normals.numpy().astype(float)
    return estimate_normals(points, radius)


def _align(source: Any, target: Any, X: np.ndarray, config: RegistrationConfig) -> Any:
    criteria = _icp.ICPConvergenceCriteria(1e-6, 1e-6, config.max_iterations)
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        for distance in config.max_distances:
            if config.method == "generalized":
                estimation = _icp.TransformationEstimationForGeneralizedICP()
                step = _icp.registration_generalized_icp(source, target, distance, X, estimation, criteria)
            else:
                estimation = _estimation(config, distance)
                step = _icp.registration_icp(source, target, distance, X, estimation, criteria)
            X = step.transformation
        return _icp.evaluate_registration(source, target, config.inlier_distance, X)


def _estimation(config: RegistrationConfig, distance: float) -> Any:
    if config.method == "point_to_point":
        return _icp.TransformationEstimationPointToPoint()
    width = config.kernel_scale * distance
    kernels = {"none": _icp.L2Loss, "tukey": lambda: _icp.TukeyLoss(width), "geman_mcclure": lambda: _icp.GMLoss(width)}
    return _icp.TransformationEstimationPointToPlane(kernels[config.kernel]())


def _judge(
    result: Any, p_SP: np.ndarray, normals: np.ndarray, X_TS_guess: RigidTransform, config: RegistrationConfig
) -> Registration:
    """Decides whether the result of ICP is used, and takes from the guess what the geometry does not say."""
    # The set of pairs is always the same, its order is not.
    pairs = np.asarray(result.correspondence_set).reshape(-1, 2)
    pairs = pairs[np.argsort(pairs[:, 0])]
    surfaces = pairs[(normals[pairs[:, 1]] != 0).any(axis=1)]
    if len(surfaces) < config.min_points or not np.isfinite(result.transformation).all():
        return _rejected(X_TS_guess, f"no overlap: {len(surfaces)} points on surfaces, needs {config.min_points}")
    fitness, rmse = float(result.fitness), round(float(result.inlier_rmse), 9)
    if fitness < config.min_fitness:
        return _rejected(X_TS_guess, f"too little overlap: fitness {fitness:.2f}, needs {config.min_fitness:g}")
    X_TS = _rounded_pose(result.transformation)
    p_TS = transform_points(X_TS.GetAsMatrix4(), p_SP[surfaces[:, 0]].astype(float))
    values, motions = constraint(p_TS, normals[surfaces[:, 1]])
    held = values >= config.min_constraint
    reason = ""
    if not held.all():
        free = sorted({AXES[int(np.abs(motions[:, i]).argmax())] for i in np.flatnonzero(~held)})
        reason = f"the geometry does not hold {', '.join(free)}: taken from the guess"
        X_TS = _rounded_pose(undo_unheld_motion(X_TS, X_TS_guess, p_TS, motions, held).GetAsMatrix4())
    correction = X_TS_guess.inverse() @ X_TS
    distance = float(np.linalg.norm(correction.translation()))
    angle = np.rad2deg(abs(correction.rotation().ToAngleAxis().angle()))
    if distance > config.max_correction or angle > config.max_correction_deg:
        return _rejected(X_TS_guess, f"jump of {distance:.2f} m, {angle:.0f} deg from the guess")
    health = fitness * float(min(values[0] / GOOD_CONSTRAINT, 1.0))
    return Registration(X_TS, fitness, rmse, len(pairs), max(health, 0.0), True, reason)


def _rejected(X_TS: RigidTransform, reason: str) -> Registration:
    return Registration(X_TS, 0.0, float("inf"), 0, 0.0, False, reason)


def _rounded_pose(X: np.ndarray) -> RigidTransform:
    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(np.round(X[:3, :3], 6)), np.round(X[:3, 3], 6))
