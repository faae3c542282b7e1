"""Rigid motions at constant twist between two poses and beyond them."""

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from ..sensing.deskew import interpolate_pose, rotation_vector


def scale_motion(X_AB: RigidTransform, s: float) -> RigidTransform:
    """The motion that A makes in `s` times the time in which it moves to B at constant twist, exp(s log X_AB)."""
    R, p = interpolate_pose(X_AB.GetAsMatrix4(), np.array([s]))
    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(R[0]), p[0])


def interpolate(X_WA: RigidTransform, X_WB: RigidTransform, s: float) -> RigidTransform:
    """The pose on the way from A (s = 0) to B (s = 1) at constant twist."""
    return X_WA @ scale_motion(X_WA.inverse() @ X_WB, s)


def distance_and_angle(X_AB: RigidTransform) -> tuple[float, float]:
    """Length of the translation [m] and angle of the rotation [rad] of a motion."""
    angle = np.linalg.norm(rotation_vector(X_AB.rotation().matrix()))
    return float(np.linalg.norm(X_AB.translation())), float(angle)
