"""Pose of a camera from points and pixels alone: the linear start of a calibration that has no guess."""

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

_SAMPLES = 300
_SAMPLE_SIZE = 8
# Points count as a plane when their extent across it is this small against the next larger one.
_FLAT = 0.02


def linear_pose(p_HP: np.ndarray, xy: np.ndarray) -> RigidTransform | None:
    """X_HC from points (N, 3) [m] and where their rays meet the plane z = 1 of the camera, (N, 2), or None.

    The direct linear transform (Hartley and Zisserman, Multiple View Geometry, 2nd ed., section 7.1) of all points and
    of 300 samples of eight, always the same ones; the pose with the smallest median error of the rays wins, so
    that up to about 30 % of the pairs may be wrong. Points on one plane are treated as a homography. At least six
    points are needed, not all on one line. What it gives is a start, not an estimate.
    """
    count = len(p_HP)
    if count < 6:
        return None
    spread = np.linalg.svd(p_HP - p_HP.mean(axis=0), compute_uv=False)
    if spread[1] < _FLAT * spread[0]:
        return None
    flat = spread[2] < _FLAT * spread[1]
    rng = np.random.default_rng(0)
    samples = [np.arange(count)]
    if count > _SAMPLE_SIZE:
        samples += [rng.choice(count, _SAMPLE_SIZE, replace=False) for _ in range(_SAMPLES)]
    best, least = None, np.inf
    for sample in samples:
        X_CH = (_from_plane if flat else _from_space)(p_HP[sample], xy[sample])
        if X_CH is None:
            continue
        p_CP = p_HP @ X_CH[:, :3].T + X_CH[:, 3]
        z = np.where(p_CP[:, 2] > 0, p_CP[:, 2], np.nan)
        error = np.linalg.norm(p_CP[:, :2] / z[:, None] - xy, axis=1)
        median = float(np.median(np.where(np.isfinite(error), error, np.inf)))
        if median < least:
            best, least = X_CH, median
    if best is None:
        return None
    R_HC = best[:, :3].T
    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(R_HC), -R_HC @ best[:, 3])


def _from_space(p_HP: np.ndarray, xy: np.ndarray) -> np.ndarray | None:
    """[R t] (3, 4) of X_CH from points that fill space."""
    centre = p_HP.mean(axis=0)
    size = np.linalg.norm(p_HP - centre, axis=1).mean()
    X = np.column_stack([(p_HP - centre) / size, np.ones(len(p_HP))])
    P = _null_vector(X, xy).reshape(3, 4)
    M = P[:, :3] / size
    U, scales, Vt = np.linalg.svd(M)
    scale = scales.mean()
    if not scale > 1e-12:
        return None
    # The matrix is known up to a factor, also in its sign: points are in front of the camera.
    sign = np.sign(np.linalg.det(M)) or 1.0
    R = sign * U @ Vt
    t = sign * P[:, 3] / scale - R @ centre
    return np.column_stack([R, t]) if np.linalg.det(R) > 0 else None


def _from_plane(p_HP: np.ndarray, xy: np.ndarray) -> np.ndarray | None:
    """[R t] (3, 4) of X_CH from points on one plane."""
    centre = p_HP.mean(axis=0)
    axes = np.linalg.svd(p_HP - centre, full_matrices=False)[2]
    if np.linalg.det(axes) < 0:
        axes[2] *= -1
    q = (p_HP - centre) @ axes.T
    size = np.linalg.norm(q, axis=1).mean()
    G = _null_vector(np.column_stack([q[:, :2] / size, np.ones(len(q))]), xy).reshape(3, 3)
    G[:, :2] /= size
    scale = np.linalg.norm(G[:, :2], axis=0).mean()
    if not scale > 1e-12:
        return None
    G *= (1.0 if G[2, 2] > 0 else -1.0) / scale
    U, _, Vt = np.linalg.svd(np.column_stack([G[:, :2], np.cross(G[:, 0], G[:, 1])]))
    R = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt @ axes
    return np.column_stack([R, G[:, 2] - R @ centre])


def _null_vector(X: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Matrix, row by row, that takes homogeneous X (N, K) to (x, y, 1) up to factors, by least squares."""
    zero = np.zeros_like(X)
    rows = np.vstack([np.hstack([X, zero, -xy[:, :1] * X]), np.hstack([zero, X, -xy[:, 1:] * X])])
    return np.asarray(np.linalg.svd(rows, full_matrices=False)[2][-1])
