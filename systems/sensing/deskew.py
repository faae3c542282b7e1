"""Motion during a sweep at constant twist: where the sensor was in between, and scans with that motion taken out."""

import math

import numpy as np
from scipy.spatial.transform import Rotation


def rotation_vector(R: np.ndarray) -> np.ndarray:
    """Rotation vector (3) [rad] of a rotation matrix (3, 3), at most π long.

    SciPy's own takes ten times as long for a single matrix; it is asked only near half a turn, where the axis cannot be
    read off the antisymmetric part.
    """
    # sin θ k and cos θ of R = cos θ I + sin θ [k] + (1 − cos θ) k kᵀ.
    x, y, z = 0.5 * (R[2, 1] - R[1, 2]), 0.5 * (R[0, 2] - R[2, 0]), 0.5 * (R[1, 0] - R[0, 1])
    sine, cosine = math.sqrt(x * x + y * y + z * z), 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1)
    if cosine < -0.99:
        return Rotation.from_matrix(R).as_rotvec()
    scale = math.atan2(sine, cosine) / sine if sine > 1e-9 else 1.0
    return np.array([x * scale, y * scale, z * scale])


def relative_twist(X_AB: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Constant twist, expressed in the moving frame, that takes frame A to frame B in one unit of time.

    It is the matrix logarithm on SE(3): v = V⁻¹(φ) p_AB with V⁻¹ = I − ½[φ] + (1 − (θ/2) cot(θ/2))/θ² [φ]²
    (Barfoot, State Estimation for Robotics, 2017, section 7.1.3).

    Args:
        X_AB: pose of B in A, (4, 4).

    Returns:
        Rotation vector φ (3) [rad], θ = |φ| at most π, and translational part v (3) [m].
    """
    rotation = rotation_vector(X_AB[:3, :3])
    p_AB = X_AB[:3, 3]
    angle = np.linalg.norm(rotation)
    x, y, z = rotation
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    once = cross @ p_AB
    # (1 − (θ/2) cot(θ/2))/θ² = 1/12 + θ²/720 + …
    second = 1 / 12 if angle < 1e-4 else (1 - 0.5 * angle / np.tan(0.5 * angle)) / angle**2
    return rotation, p_AB - 0.5 * once + second * cross @ once


def transform_by_twist(points: np.ndarray, fraction: np.ndarray, rotation: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Moves every point by its own fraction of a twist: p' = exp(α ξ) p, in the precision of `points`.

    Args:
        points: (N, 3) [m].
        fraction: α of every point, (N,).
        rotation, v: the twist ξ, as from `relative_twist`.
    """
    angle, *terms = _screw(rotation, v)
    cross, v_along, v_across, v_turned = (term.astype(points.dtype) for term in terms)
    fraction = np.asarray(fraction, points.dtype)
    turned = fraction * points.dtype.type(angle)
    # p' = p + sin(αθ) (k×p + v⊥/θ) + (1 − cos(αθ)) (k×(k×p) + k×v/θ) + α v∥
    moved = points @ cross.T
    moved += v_across
    moved *= np.sin(turned)[:, None]
    cosine_terms = points @ (cross @ cross).T
    cosine_terms += v_turned
    # 1 − cos x = 2 sin²(x/2) does not lose the small angles to rounding.
    cosine_terms *= (2 * np.sin(0.5 * turned) ** 2)[:, None]
    moved += cosine_terms
    moved += points
    moved += np.multiply.outer(fraction, v_along)
    return moved


def _screw(rotation: np.ndarray, v: np.ndarray) -> tuple[float, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A twist as a screw about unit vector k: θ, the matrix [k] of k×, v∥, v⊥/θ and k×v/θ. No turn: all of v is v∥."""
    angle = float(np.linalg.norm(rotation))
    if angle < 1e-9:
        return 0.0, np.zeros((3, 3)), v, np.zeros(3), np.zeros(3)
    k = rotation / angle
    cross = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    v_along = k * (k @ v)
    return angle, cross, v_along, (v - v_along) / angle, cross @ v / angle


def interpolate_pose(X_AB: np.ndarray, fraction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Poses on the way from A to B at constant twist, in A.

    Args:
        X_AB: pose of B in A, (4, 4).
        fraction: (K,), 0 at A and 1 at B.

    Returns:
        Rotations (K, 3, 3) and positions (K, 3) [m].
    """
    rotation, v = relative_twist(X_AB)
    angle, cross, v_along, v_across, v_turned = _screw(rotation, v)
    turned = np.asarray(fraction, float) * angle
    sine, cosine = np.sin(turned), 2 * np.sin(0.5 * turned) ** 2
    R = np.eye(3) + np.multiply.outer(sine, cross) + np.multiply.outer(cosine, cross @ cross)
    p = np.outer(fraction, v_along) + np.outer(sine, v_across) + np.outer(cosine, v_turned)
    return R, p


def deskew(p_SP: np.ndarray, time_fraction: np.ndarray, X_S0S1: np.ndarray) -> np.ndarray:
    """Brings the points of a sweep into the sensor frame at the end of the scan, at constant twist.

    Args:
        p_SP: points, each in the sensor frame at its own instant, (N, 3) [m].
        time_fraction: instant of every point, (N,), 0 at the start of the scan and 1 at its end.
        X_S0S1: pose of the sensor at the end of the scan in the sensor at its start, (4, 4); measured or estimated.

    Returns:
        p_S1P (N, 3) float32 [m].
    """
    points = np.asarray(p_SP, np.float32).reshape(-1, 3)
    return transform_by_twist(points, np.asarray(time_fraction, np.float32).ravel() - 1, *relative_twist(X_S0S1))
