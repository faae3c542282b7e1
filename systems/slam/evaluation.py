"""How far a trajectory and a map are from the true ones; nothing in the loop may use this."""

from collections.abc import Sequence

import numpy as np
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform
from scipy.spatial import KDTree

from ..clouds import VoxelCloud
from .keyframe import Keyframe
from .motion import interpolate

ALIGNMENTS = ("first", "none")


def trajectory_error(
    times_est: Sequence[float] | np.ndarray,
    X_est: np.ndarray,
    times_true: Sequence[float] | np.ndarray,
    X_true: np.ndarray,
    align: str = "first",
) -> tuple[float, float]:
    """Mean and largest distance between estimated and true positions [m].

    The truth is interpolated at constant twist; estimates before its start or after its end do not count.

    Args:
        times_est, times_true: (N,), (K,), strictly increasing [s].
        X_est, X_true: (N, 4, 4), (K, 4, 4).
        align: "first" lays the first pose of the estimate that counts on the true one, "none" compares as they are.

    Raises:
        ValueError: unknown alignment, lengths that differ, or no time in common.
    """
    if align not in ALIGNMENTS:
        raise ValueError(f"align must be one of {ALIGNMENTS}, got {align!r}")
    t_est, t_true = np.asarray(times_est, float), np.asarray(times_true, float)
    X_est, X_true = np.asarray(X_est, float).reshape(-1, 4, 4), np.asarray(X_true, float).reshape(-1, 4, 4)
    if len(t_est) != len(X_est) or len(t_true) != len(X_true):
        raise ValueError(f"{len(t_est)} times for {len(X_est)} poses, {len(t_true)} times for {len(X_true)} true poses")
    common = (t_est >= t_true[0]) & (t_est <= t_true[-1]) if len(t_true) else np.zeros(len(t_est), bool)
    if not common.any():
        raise ValueError("the trajectories have no time in common")
    truth = np.stack([_pose_at(t_true, X_true, time) for time in t_est[common]])
    estimate = X_est[common]
    if align == "first":
        estimate = truth[0] @ np.linalg.inv(estimate[0]) @ estimate
    errors = np.linalg.norm(estimate[:, :3, 3] - truth[:, :3, 3], axis=1)
    return float(errors.mean()), float(errors.max())


def map_error(points: np.ndarray, reference: np.ndarray) -> float:
    """Mean distance from each point of a map to the nearest point of the reference [m].

    S0-g reports it for maps of the same scans, with the map on the true path as the reference: see `rebuild_map`.

    Args:
        points, reference: (N, 3), (K, 3) [m].

    Raises:
        ValueError: either is empty.
    """
    points, reference = np.asarray(points, float).reshape(-1, 3), np.asarray(reference, float).reshape(-1, 3)
    if len(points) == 0 or len(reference) == 0:
        raise ValueError(f"a map without points: {len(points)} points, {len(reference)} in the reference")
    return float(KDTree(reference).query(points)[0].mean())


def rebuild_map(
    keyframes: Sequence[Keyframe], poses: Sequence[RigidTransform] | np.ndarray, voxel: float
) -> PointCloud:
    """The clouds of `keyframes` at other poses X_MB, thinned to one mean point a `voxel` [m].

    Args:
        poses: one a keyframe: odometry, estimate or truth, as `RigidTransform` or (N, 4, 4).

    Raises:
        ValueError: another number of poses.
    """
    if len(keyframes) != len(poses):
        raise ValueError(f"{len(poses)} poses for {len(keyframes)} keyframes")
    voxels = VoxelCloud(voxel)
    for keyframe, pose in zip(keyframes, poses, strict=True):
        X = pose.GetAsMatrix4() if isinstance(pose, RigidTransform) else np.asarray(pose, float)
        voxels = voxels.insert(keyframe.cloud_B, X)
    return voxels.to_cloud()


def _pose_at(times: np.ndarray, X: np.ndarray, time: float) -> np.ndarray:
    after = int(np.searchsorted(times, time))
    if times[after] == time:
        return X[after]
    s = (time - times[after - 1]) / (times[after] - times[after - 1])
    return interpolate(RigidTransform(X[after - 1]), RigidTransform(X[after]), float(s)).GetAsMatrix4()
