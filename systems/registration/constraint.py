"""Which motions the surfaces around a robot hold, and what to do about the others."""

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial.transform import Rotation

AXES = ("roll", "pitch", "yaw", "x", "y", "z")


@dataclass(frozen=True, eq=False)
class Hold:
    """How firmly surfaces hold a rigid body.

    Attributes:
        values: part of each motion that is felt, ascending, (6,) in [0, 1]; see `constraint`.
        motions: the motions as columns (6, 6).
        centre: the point (3,) that they turn about [m].
        radius: of the points around it, root mean square [m].
    """

    values: np.ndarray
    motions: np.ndarray
    centre: np.ndarray
    radius: float

    def names(self, which: np.ndarray) -> str:
        """What motions turn about or go along, for people: the axes nearest to those of the mask `which` (6,)."""
        return ", ".join(sorted({AXES[int(np.abs(self.motions[:, i]).argmax())] for i in np.flatnonzero(which)}))

    def at_point(self, point: np.ndarray) -> np.ndarray:
        """(6, 6) that takes shares of the motions to turn [rad] and shift [m] of `point` (3,)."""
        to_point = np.eye(6)
        to_point[:3, :3] /= self.radius
        to_point[3:, :3] = -_cross(point - self.centre) / self.radius  # ω × (point − c)
        return to_point @ self.motions


def constraint(points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How firmly planes through `points` with unit `normals`, (N, 3) each, hold a rigid body.

    A small motion v = [roll, pitch, yaw, x, y, z] about the centroid c moves point p by d = ω × (p − c) + t, and of
    that, the planes feel n·d. The values λ solve H v = λ M v with vᵀHv = mean (n·d)² (the Hessian of point-to-plane
    ICP) and vᵀMv = mean |d|²: λ is the part of the motion that is felt, in [0, 1], in no unit and for no scale. Along a
    corridor, or about the axis of a cylinder, it is 0; in a closed room the smallest is about 0.1.

    Returns:
        λ in ascending order, (6,), and the motions as columns, (6, 6), scaled to vᵀMv = 1. Turns are in units of 1/r,
        r the root mean square distance of the points from c, and so of the size of the shifts.
    """
    hold = hold_of(points, normals)
    return hold.values, hold.motions


def hold_of(points: np.ndarray, normals: np.ndarray) -> Hold:
    """`constraint` with the centre and radius that it is about."""
    centre = points.mean(axis=0)
    lever = points - centre
    jacobian = np.hstack([np.cross(lever, normals), normals])
    count = max(len(points), 1)
    return hold_from_sums(jacobian.T @ jacobian / count, lever.mean(axis=0), lever.T @ lever / count, centre)


def hold_from_sums(hessian: np.ndarray, mean: np.ndarray, second: np.ndarray, centre: np.ndarray) -> Hold:
    """The same from weighted means over the points, with lever arms l = p − centre.

    Args:
        hessian: mean of J Jᵀ, J = [l × n, n], (6, 6).
        mean, second: means of l (3,) and of l lᵀ (3, 3).
    """
    radius = max(float(np.sqrt(np.trace(second))), 1e-12)
    M = np.eye(6)
    M[:3, :3] = (np.trace(second) * np.eye(3) - second) / radius**2
    M[3:, :3] = -_cross(mean) / radius
    M[:3, 3:] = M[3:, :3].T
    M += 1e-9 * np.eye(6)  # for points on one line, which a turn about it does not move
    unit = np.array([1 / radius] * 3 + [1.0] * 3)
    values, motions = scipy.linalg.eigh(hessian * np.outer(unit, unit), M, check_finite=False)
    return Hold(values, motions, centre, radius)


def moved(X_TS: RigidTransform, hold: Hold, shares: np.ndarray) -> RigidTransform:
    """The pose X_TS after `shares` (6,) of the motions of `hold`: a turn about its centre and a shift [m]."""
    motion = hold.motions @ shares
    R = RotationMatrix(Rotation.from_rotvec(motion[:3] / hold.radius).as_matrix())
    return RigidTransform(R, hold.centre - R.matrix() @ hold.centre + motion[3:]) @ X_TS


def motion_from(X_TS: RigidTransform, X_TS_other: RigidTransform, hold: Hold) -> np.ndarray:
    """Shares (6,) of the motions of `hold` that lead from X_TS to another pose, to first order in the turn."""
    change = X_TS_other @ X_TS.inverse()
    turn = Rotation.from_matrix(change.rotation().matrix()).as_rotvec()
    shift = change.multiply(hold.centre) - hold.centre
    shares: np.ndarray = np.linalg.solve(hold.motions, np.concatenate([hold.radius * turn, shift]))
    return shares


def undo_unheld_motion(
    X_TS: RigidTransform, X_TS_guess: RigidTransform, p_TS: np.ndarray, motions: np.ndarray, held: np.ndarray
) -> RigidTransform:
    """The pose X_TS of a registration, except along the motions that nothing holds: those are taken from the guess.

    This is solution remapping (Zhang, Kaess and Singh, On degeneracy of optimization-based state estimation problems,
    ICRA 2016), to first order in the turn between guess and result.

    Args:
        p_TS: points that were matched, at X_TS, (N, 3).
        motions: columns as from `constraint` for these points.
        held: which of them are to be kept, (6,) bool.
    """
    centre = p_TS.mean(axis=0)
    radius = max(float(np.sqrt(((p_TS - centre) ** 2).sum(axis=1).mean())), 1e-12)
    hold = Hold(np.zeros(6), motions, centre, radius)
    return moved(X_TS, hold, np.where(held, 0.0, motion_from(X_TS, X_TS_guess, hold)))


def _cross(v: np.ndarray) -> np.ndarray:
    """The matrix that takes w to v × w."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
