"""Many rigid motions at once: inverses, logarithms and adjoints of arrays (…, 4, 4).

A small motion is ξ = [roll, pitch, yaw, x, y, z] [rad, m], turn first, as gtsam orders it. It acts on the right,
X Exp(ξ): about and along the axes of the moved frame.
"""

import numpy as np
from scipy.spatial.transform import Rotation


def inverse(X: np.ndarray) -> np.ndarray:
    """Inverses of poses (…, 4, 4)."""
    result = np.zeros_like(X)
    R_transposed = np.swapaxes(X[..., :3, :3], -1, -2)
    result[..., :3, :3] = R_transposed
    result[..., :3, 3] = -np.einsum("...ij,...j->...i", R_transposed, X[..., :3, 3])
    result[..., 3, 3] = 1
    return result


def cross_matrix(v: np.ndarray) -> np.ndarray:
    """Matrices [v]× of vectors (…, 3), (…, 3, 3)."""
    result = np.zeros((*v.shape, 3))
    result[..., 0, 1], result[..., 0, 2], result[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return result - np.swapaxes(result, -1, -2)


def logarithm(X: np.ndarray) -> np.ndarray:
    """ξ with X = Exp(ξ) on SE(3), (N, 6), of poses (N, 4, 4) (Barfoot, State Estimation for Robotics, 7.1.3)."""
    turn = Rotation.from_matrix(X[:, :3, :3]).as_rotvec()
    p = X[:, :3, 3]
    angle = np.linalg.norm(turn, axis=1)
    wide = np.maximum(angle, 1e-4)
    # (1 − (θ/2) cot(θ/2))/θ² = 1/12 + θ²/720 + …
    second = np.where(angle < 1e-4, 1 / 12, (1 - 0.5 * wide / np.tan(0.5 * wide)) / wide**2)
    once = np.cross(turn, p)
    return np.hstack([turn, p - 0.5 * once + second[:, None] * np.cross(turn, once)])


def exponential(xi: np.ndarray) -> np.ndarray:
    """Poses (N, 4, 4) of ξ (N, 6), the inverse of `logarithm`."""
    turn, v = xi[:, :3], xi[:, 3:]
    angle = np.linalg.norm(turn, axis=1)[:, None]
    wide = np.maximum(angle, 1e-4)
    first = np.where(angle < 1e-4, 0.5, (1 - np.cos(wide)) / wide**2)
    second = np.where(angle < 1e-4, 1 / 6, (wide - np.sin(wide)) / wide**3)
    once = np.cross(turn, v)
    X = np.tile(np.eye(4), (len(xi), 1, 1))
    X[:, :3, :3] = Rotation.from_rotvec(turn).as_matrix()
    X[:, :3, 3] = v + first * once + second * np.cross(turn, once)
    return X


def adjoint(X: np.ndarray) -> np.ndarray:
    """Ad with X Exp(ξ) X⁻¹ = Exp(Ad ξ), (…, 6, 6)."""
    R = X[..., :3, :3]
    result = np.zeros((*X.shape[:-2], 6, 6))
    result[..., :3, :3] = result[..., 3:, 3:] = R
    result[..., 3:, :3] = cross_matrix(X[..., :3, 3]) @ R
    return result
