"""Poses in the plane, (x, y, heading) [m, m, rad], as arrays (3,): X_AB is the pose of B in A."""

import math

import numpy as np
from numba import njit


@njit(cache=True)
def wrap(angle: float) -> float:
    """The same angle in (-pi, pi]."""
    return math.atan2(math.sin(angle), math.cos(angle))


@njit(cache=True)
def compose(X_AB: np.ndarray, X_BC: np.ndarray) -> np.ndarray:
    """X_AC."""
    c, s = math.cos(X_AB[2]), math.sin(X_AB[2])
    return np.array(
        [
            X_AB[0] + c * X_BC[0] - s * X_BC[1],
            X_AB[1] + s * X_BC[0] + c * X_BC[1],
            wrap(X_AB[2] + X_BC[2]),
        ]
    )


@njit(cache=True)
def between(X_AB: np.ndarray, X_AC: np.ndarray) -> np.ndarray:
    """X_BC."""
    c, s = math.cos(X_AB[2]), math.sin(X_AB[2])
    dx, dy = X_AC[0] - X_AB[0], X_AC[1] - X_AB[1]
    return np.array([c * dx + s * dy, -s * dx + c * dy, wrap(X_AC[2] - X_AB[2])])


@njit(cache=True)
def inverse(X_AB: np.ndarray) -> np.ndarray:
    """X_BA."""
    return between(X_AB, np.zeros(3))


@njit(cache=True)
def difference(X_AB: np.ndarray, X_AC: np.ndarray) -> np.ndarray:
    """X_AC - X_AB in the axes of A, the turn wrapped: what covariances here are of."""
    return np.array([X_AC[0] - X_AB[0], X_AC[1] - X_AB[1], wrap(X_AC[2] - X_AB[2])])


@njit(cache=True)
def transform(X_AB: np.ndarray, p_BP: np.ndarray) -> np.ndarray:
    """Points p_AP, (n, 2) [m]."""
    c, s = math.cos(X_AB[2]), math.sin(X_AB[2])
    result = np.empty_like(p_BP)
    for k in range(len(p_BP)):
        result[k, 0] = X_AB[0] + c * p_BP[k, 0] - s * p_BP[k, 1]
        result[k, 1] = X_AB[1] + s * p_BP[k, 0] + c * p_BP[k, 1]
    return result


@njit(cache=True)
def turned(covariance: np.ndarray, angle: float) -> np.ndarray:
    """A covariance of (x, y, heading), (3, 3), given in axes that stand at `angle` in A, in those of A."""
    c, s = math.cos(angle), math.sin(angle)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return R @ covariance @ R.T


@njit(cache=True)
def levered(covariance: np.ndarray, dx: float, dy: float) -> np.ndarray:
    """That of the pose of a body, from that of another that it is rigidly joined to; (dx, dy) from this one to it."""
    T = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
    return T @ covariance @ T.T


def to_matrix(pose: np.ndarray) -> np.ndarray:
    """Poses (..., 3) as rigid transforms (..., 4, 4) that turn about z."""
    pose = np.asarray(pose, float)
    X = np.zeros((*pose.shape[:-1], 4, 4))
    X[..., 0, 0] = X[..., 1, 1] = np.cos(pose[..., 2])
    X[..., 1, 0] = np.sin(pose[..., 2])
    X[..., 0, 1] = -X[..., 1, 0]
    X[..., 0, 3], X[..., 1, 3] = pose[..., 0], pose[..., 1]
    X[..., 2, 2] = X[..., 3, 3] = 1.0
    return X


def from_matrix(X: np.ndarray) -> np.ndarray:
    """Position and the direction of the x axis seen from above, (..., 3), of transforms (..., 4, 4)."""
    return np.stack([X[..., 0, 3], X[..., 1, 3], np.arctan2(X[..., 1, 0], X[..., 0, 0])], axis=-1)
