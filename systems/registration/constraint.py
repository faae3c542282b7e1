"""Which motions the surfaces around a robot hold, and what to do about the others."""

import numpy as np
import scipy.linalg
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial.transform import Rotation

AXES = ("roll", "pitch", "yaw", "x", "y", "z")


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
    count = max(len(points), 1)
    centre, radius = _size(points)
    lever = (points - centre) / radius
    felt = np.hstack([np.cross(lever, normals), normals])
    cross = np.zeros((len(points), 3, 3))  # of d = -[lever]x ω + t
    x, y, z = lever.T
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = z, -y, x
    moved = np.concatenate([cross - cross.transpose(0, 2, 1), np.broadcast_to(np.eye(3), cross.shape)], axis=2)
    moved = moved.reshape(-1, 6)
    M = moved.T @ moved / count
    M += 1e-9 * np.eye(6)  # for points on one line, which a turn about it does not move
    values, motions = scipy.linalg.eigh(felt.T @ felt / count, M)
    return values, motions


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
    centre, radius = _size(p_TS)
    change = X_TS @ X_TS_guess.inverse()
    turn = Rotation.from_matrix(change.rotation().matrix()).as_rotvec()
    shift = centre - change.inverse().multiply(centre)
    shares = np.linalg.solve(motions, np.concatenate([radius * turn, shift]))
    unheld = motions @ np.where(held, 0.0, shares)
    R = RotationMatrix(Rotation.from_rotvec(-unheld[:3] / radius).as_matrix())
    # Turns back about the centre and shifts back.
    return RigidTransform(R, centre - R.matrix() @ centre - unheld[3:]) @ X_TS


def _size(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Centroid and root mean square distance from it."""
    centre = points.mean(axis=0)
    return centre, max(float(np.sqrt(((points - centre) ** 2).sum(axis=1).mean())), 1e-12)
