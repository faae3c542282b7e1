"""Attribute ICP as published: a penalty on partners of other classes, and a wider search for rare ones."""

from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial import KDTree

from ..config import quantity
from ..errors import InputError


@dataclass(kw_only=True)
class AttributeIcpConfig:
    """The constants of S2-c, which the paper does not give."""

    # [m²] Penalty α on a partner of another class: one of the same class may be √α farther away.
    penalty: float = quantity(0.25, unit="m²", low=0)
    # [m] Radius in which a partner is searched, and for points of rare classes.
    radius: float = quantity(0.5, unit="m", above=0)
    rare_radius: float = quantity(1.5, unit="m", above=0)
    # Classes with less than this share of the points of both clouds are rare.
    rare_share: float = quantity(0.1, low=0, high=1)
    # At most so many iterations, until a step moves no point of the source by more than `tolerance` [m].
    max_iterations: int = quantity(60, unit="iterations", low=1)
    tolerance: float = quantity(1e-4, unit="m", low=0)


@dataclass(frozen=True, eq=False)
class AttributeIcpResult:
    """What `attribute_icp` found.

    Attributes:
        X_TS: pose of the source in the target; the guess when there were fewer than three pairs.
        pairs: indices in source and target, (n, 2), of the last iteration.
        cost: E of Eq. 2 over these pairs, before the last step [m²].
        iterations: number of them.
        converged: the last step was below the tolerance.
    """

    X_TS: RigidTransform
    pairs: np.ndarray
    cost: float
    iterations: int
    converged: bool


def rare_classes(source_classes: np.ndarray, target_classes: np.ndarray, share: float) -> np.ndarray:
    """Ids of the classes that less than `share` of all points have, found from counts (S2-a)."""
    ids, counts = np.unique(np.concatenate([source_classes, target_classes]), return_counts=True)
    return ids[counts < share * counts.sum()]


class ClassSearch:
    """Nearest partners by |p - q|² + λ, λ = α where classes differ, within a radius.

    A class is a corner of a simplex whose squared edge is α, in dimensions of their own: there, the squared distance of
    two points is the whole cost, and its minimum one query of a k-d tree. Where this lies beyond the radius, nothing
    of the same class is within it (that would cost less), and what is best is the nearest point of all.
    """

    def __init__(self, points: np.ndarray, classes: np.ndarray, penalty: float):
        """points: (M, 3) [m]. classes: (M,) ids. penalty: α [m²]."""
        self._classes = np.unique(classes)
        self._edge = np.sqrt(penalty / 2)
        self._lifted = KDTree(np.hstack([points, self._corners(classes)]))
        self._plain = KDTree(points)
        self._points, self._ids = points, classes
        self.penalty = penalty

    def __call__(self, points: np.ndarray, classes: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Partner of every point (N, 3), (N,) int, -1 for none within its radius (N,), and the cost (N,) [m²]."""
        index = self._lifted.query(np.hstack([points, self._corners(classes)]))[1]
        square = ((points - self._points[index]) ** 2).sum(axis=1)
        beyond = np.flatnonzero(square > radius**2)
        if len(beyond):
            index[beyond] = self._plain.query(points[beyond])[1]
            square[beyond] = ((points[beyond] - self._points[index[beyond]]) ** 2).sum(axis=1)
        cost = square + self.penalty * (self._ids[index] != classes)
        return np.where(square <= radius**2, index, -1), cost

    def _corners(self, classes: np.ndarray) -> np.ndarray:
        """(N, K + 1); a class that the target does not have has the last corner."""
        place = np.searchsorted(self._classes, classes)
        known = self._classes[np.minimum(place, len(self._classes) - 1)] == classes
        corners = np.zeros((len(classes), len(self._classes) + 1))
        corners[np.arange(len(classes)), np.where(known, place, len(self._classes))] = self._edge
        return corners


def attribute_icp(
    source_points: np.ndarray,
    source_classes: np.ndarray,
    target_points: np.ndarray,
    target_classes: np.ndarray,
    X0: RigidTransform,
    config: AttributeIcpConfig | None = None,
) -> AttributeIcpResult:
    """Lays the source on the target by E = Σ |p_k − (R q + T)|² + λ(p_k, q), λ = α if classes differ (S2-c, Eq. 2).

    Every iteration pairs each point with the one that costs least within its radius, which is wider for rare classes,
    and takes the pose that is best for these pairs (Kabsch); λ only decides who is paired.

    Args:
        source_points, target_points: (N, 3) in S and (M, 3) in T [m].
        source_classes, target_classes: class ids, (N,) and (M,), as the largest of `class_probabilities`.
        X0: guess of X_TS.

    Raises:
        InputError: points and classes do not fit, or the target is empty.
    """
    config = config or AttributeIcpConfig()
    source, target = np.asarray(source_points, float), np.asarray(target_points, float)
    source_ids, target_ids = np.asarray(source_classes).ravel(), np.asarray(target_classes).ravel()
    for name, points, ids in (("source", source, source_ids), ("target", target, target_ids)):
        if points.ndim != 2 or points.shape[1] != 3 or len(points) != len(ids):
            raise InputError("points and classes do not fit", key=name, value=(points.shape, ids.shape))
    if not len(target):
        raise InputError("there is nothing to lay it on", key="target", value=0, valid="points")
    search = ClassSearch(target, target_ids, config.penalty)
    rare = np.isin(source_ids, rare_classes(source_ids, target_ids, config.rare_share))
    radius = np.where(rare, max(config.rare_radius, config.radius), config.radius)
    R, p = X0.rotation().matrix(), X0.translation()
    pairs, cost, iteration, converged = np.zeros((0, 2), np.intp), np.inf, 0, False
    for iteration in range(1, config.max_iterations + 1):
        moved = source @ R.T + p
        partner, costs = search(moved, source_ids, radius)
        found = np.flatnonzero(partner >= 0)
        if len(found) < 3:
            return AttributeIcpResult(X0, pairs, np.inf, iteration, False)
        pairs, cost = np.column_stack([found, partner[found]]), float(costs[found].sum())
        R, p = _kabsch(source[found], target[partner[found]])
        step = np.abs(source @ R.T + p - moved).max()
        if step <= config.tolerance:
            converged = True
            break
    X_TS = RigidTransform(RotationMatrix.ProjectToRotationMatrix(R), p)
    return AttributeIcpResult(X_TS, pairs, cost, iteration, converged)


def _kabsch(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and shift that bring `source` (n, 3) to `target` with the least sum of squares."""
    centre_S, centre_T = source.mean(axis=0), target.mean(axis=0)
    U, _, Vt = np.linalg.svd((target - centre_T).T @ (source - centre_S))
    R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    return R, centre_T - R @ centre_S
