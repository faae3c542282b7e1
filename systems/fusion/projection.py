"""Eq. 1 for any camera: which points it sees, where in its image, and what the image says there."""

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from ..errors import CameraError
from ..sensing.camera_model import CameraModel


def check_extrinsics(matrix: np.ndarray, where: str = "X_BC") -> RigidTransform:
    """The pose in a (4, 4) `matrix`.

    Raises:
        CameraError: it is not finite, singular, mirrored or otherwise not a rigid motion.
    """
    X = np.asarray(matrix, float)
    valid = "a rotation, a finite translation and the last row 0 0 0 1"
    if X.shape != (4, 4):
        raise CameraError("extrinsics of the wrong shape", where=where, value=X.shape, valid="(4, 4)")
    if not np.isfinite(X).all():
        raise CameraError("extrinsics are not finite", where=where, value=X.tolist(), valid=valid)
    determinant = float(np.linalg.det(X[:3, :3]))
    if abs(determinant) < 1e-6:
        raise CameraError("extrinsics are singular", where=where, value=X.tolist(), valid=valid)
    rigid = np.abs(X[:3, :3] @ X[:3, :3].T - np.eye(3)).max() < 1e-5 and determinant > 0
    if not rigid or np.abs(X[3] - [0, 0, 0, 1]).max() > 1e-9:
        raise CameraError("extrinsics are not a rigid motion", where=where, value=X.tolist(), valid=valid)
    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(X[:3, :3]), X[:3, 3])


def check_pan_tilt(angles: np.ndarray, low: np.ndarray, high: np.ndarray, where: str = "pan_tilt_angles") -> np.ndarray:
    """Pan and tilt (2) [rad] as floats.

    Raises:
        CameraError: an angle is not finite or outside `low` to `high` [rad], give or take a thousandth.
    """
    checked = np.asarray(angles, float).ravel()
    valid = ", ".join(f"{name} {a:.3g} to {b:.3g} rad" for name, a, b in zip(("pan", "tilt"), low, high, strict=True))
    if checked.shape != (2,) or not np.isfinite(checked).all():
        raise CameraError("not two finite angles", where=where, value=checked.tolist(), valid=valid)
    if (checked < np.asarray(low) - 1e-3).any() or (checked > np.asarray(high) + 1e-3).any():
        raise CameraError("pan-tilt angles out of range", where=where, value=checked.tolist(), valid=valid)
    return checked


def project(
    p_BP: np.ndarray, X_CB: RigidTransform, camera: CameraModel, max_range: float = np.inf
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Eq. 1 of the source (S0-a): m ≅ A (R p + t), for the points that fall into the image.

    The four planes around the field of view sort out the others before anything is divided or distorted.

    Args:
        p_BP: points in any frame B, (N, 3) [m]; those that are not finite are left out.
        X_CB: pose of B in the camera frame C: R and t of Eq. 1.
        max_range: distance beyond which points are left out [m].

    Returns:
        index (M,) of the points, rising, their pixel coordinates uv (M, 2) and p_CP (M, 3), both float32.
    """
    points = np.asarray(p_BP, np.float32).reshape(-1, 3)
    return project_rows(move_rows(points, X_CB.rotation().matrix(), X_CB.translation()), camera, max_range)


def project_rows(
    p_CP: np.ndarray, camera: CameraModel, max_range: float = np.inf
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `project`, for points in the camera frame, one row an axis, (3, N) float32."""
    low, high = camera.field_of_view
    margin = 0.01 * (high - low)  # for rounding
    low, high = (low - margin).astype(np.float32), (high + margin).astype(np.float32)
    x, y, z = p_CP
    near = (z > 0) & (x >= low[0] * z) & (x <= high[0] * z)
    near &= (y >= low[1] * z) & (y <= high[1] * z)
    index = np.flatnonzero(near)
    seen = np.ascontiguousarray(p_CP[:, index].T)
    uv, inside = camera.project(seen)
    if np.isfinite(max_range):
        inside &= np.einsum("ij,ij->i", seen, seen) <= np.float32(max_range) ** 2
    return index[inside], uv[inside], seen[inside]


def move_rows(points: np.ndarray, R: np.ndarray, p: np.ndarray) -> np.ndarray:
    """R points + p, one row an axis, (3, N) float32: long rows are what makes this fast."""
    with np.errstate(invalid="ignore"):  # points at infinity
        moved = R.astype(np.float32) @ points.T
        moved += np.asarray(p, np.float32)[:, None]
    return moved


def sample(image: np.ndarray, uv: np.ndarray, method: str = "bilinear") -> np.ndarray:
    """Values of `image` (H, W) float at pixel coordinates `uv` (N, 2), (N,) float32.

    Pixels that are not finite have no value. "bilinear" takes the mean of those of the four neighbours that have one,
    by their bilinear weights, if these are half of the whole or more; "nearest" takes the nearest pixel. NaN where
    there is no value, and outside of the image, whose pixels reach half a pixel around their centres.
    """
    height, width = image.shape
    uv = np.asarray(uv).reshape(-1, 2)
    # False for NaN.
    u, v = uv[:, 0], uv[:, 1]
    inside = (u >= -0.5) & (v >= -0.5) & (u < width - 0.5) & (v < height - 0.5)
    u, v = np.where(inside, u, 0), np.where(inside, v, 0)
    flat = np.asarray(image, np.float32).ravel()
    if method == "nearest":
        index = np.floor(v + 0.5).astype(np.intp) * width + np.floor(u + 0.5).astype(np.intp)
        values = flat[index]
        return np.where(inside & np.isfinite(values), values, np.float32(np.nan))
    u, v = np.clip(u, 0, width - 1), np.clip(v, 0, height - 1)
    u0, v0 = np.floor(u).astype(np.intp), np.floor(v).astype(np.intp)
    right, down = (u - u0).astype(np.float32), (v - v0).astype(np.float32)
    u1, v1 = np.minimum(u0 + 1, width - 1), np.minimum(v0 + 1, height - 1)
    total, weight = np.zeros((2, len(uv)), np.float32)
    for column, row, share in (
        (u0, v0, (1 - right) * (1 - down)),
        (u1, v0, right * (1 - down)),
        (u0, v1, (1 - right) * down),
        (u1, v1, right * down),
    ):
        value = flat[row * width + column]
        known = np.isfinite(value)
        weight += share * known
        total += share * np.where(known, value, 0)
    inside &= weight >= 0.499
    return np.divide(total, weight, out=np.full(len(uv), np.nan, np.float32), where=inside)
