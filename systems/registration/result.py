"""What registration returns."""

from dataclasses import dataclass, replace

import numpy as np
from pydrake.math import RigidTransform

FIXED_BY = ("geometry", "classes", "guess")


@dataclass(frozen=True, eq=False)
class Axis:
    """One principal motion of a result, and who said how far to go along it.

    Attributes:
        motion: (6,) roll, pitch, yaw, x, y, z: a small turn about and shift along T's axes of the centroid of the
            matched points. Turns are in units of 1/r, r the points' root mean square distance from it, see
            `constraint`: points move by 1 m, root mean square, for a unit of it.
        fixed_by: "geometry", "classes" or "guess".
        deviation: standard deviation along it [m].
        constraint: part of the motion that the surfaces feel, [0, 1], see `constraint`.
    """

    motion: np.ndarray
    fixed_by: str
    deviation: float
    constraint: float


@dataclass(frozen=True, eq=False)
class Registration:
    """The result of `register`.

    Attributes:
        X_TS: pose of the source in the target; the guess when `valid` is False.
        covariance: (6, 6), order roll, pitch, yaw, x, y, z [rad, m], of a small turn ω about and shift t along T's axes
            of the source's origin: the true pose is (Exp(ω) R, p + t). Infinite on the diagonal when it is not valid.
        fitness: part of the source's surfaces (of its thinned points, with Open3D's methods) that are inliers, [0, 1].
        inlier_rmse: root mean square distance of the inliers to their partners [m], along their normal with
            `surfaces`; inf when it is not valid.
        inliers: number of them.
        axes: the principal motions, from the one that the geometry holds least; empty when it is not valid.
        health: [0, 1]; fitness times how well the motion is held that is held least.
        valid: whether `X_TS` may be used.
        reason: why it is not valid, or which motions do not come from the geometry; else "".
    """

    X_TS: RigidTransform
    covariance: np.ndarray
    fitness: float
    inlier_rmse: float
    inliers: int
    axes: tuple[Axis, ...]
    health: float
    valid: bool
    reason: str

    def __deepcopy__(self, memo: dict) -> "Registration":
        return self

    def at(self, X_SB: RigidTransform) -> "Registration":
        """The same for a frame B that is fixed to the source: its pose X_TB, with the covariance at B's origin."""
        lever = self.X_TS.rotation().matrix() @ X_SB.translation()
        covariance = covariance_at(self.covariance, lever) if self.valid else self.covariance
        return replace(self, X_TS=self.X_TS @ X_SB, covariance=covariance)


def covariance_at(covariance: np.ndarray, lever: np.ndarray) -> np.ndarray:
    """Covariance (6, 6) of a small turn and shift at a point, for the point that is `lever` (3,) [m] away from it."""
    x, y, z = lever
    to_point = np.eye(6)
    to_point[3:, :3] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]  # ω × lever
    moved: np.ndarray = to_point @ covariance @ to_point.T
    return moved


def placed(X_TS: RigidTransform, points: int) -> Registration:
    """The result for a cloud that is where it is by definition: the first of a map."""
    return Registration(X_TS, np.zeros((6, 6)), 1.0, 0.0, points, (), 1.0, True, "")


def rejected(X_TS: RigidTransform, reason: str) -> Registration:
    """The result of a registration that failed: the guess, and why."""
    return Registration(X_TS, np.diag(np.full(6, np.inf)), 0.0, float("inf"), 0, (), 0.0, False, reason)
