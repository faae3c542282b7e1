"""How the snake lies, from its joint angles and the attitude of its head, and its measurements half by half."""

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from .chain import ChainKinematics
from .contact_pads import PAD_PLACES


def tilt_rotation(rpy: np.ndarray) -> np.ndarray:
    """R_HB (3, 3) from roll and pitch alone: the heading frame H has z up and the heading of the body."""
    (sr, sp), (cr, cp) = np.sin(rpy[:2]), np.cos(rpy[:2])
    return np.array([[cp, sp * sr, sp * cr], [0.0, cr, -sr], [-sp, cp * sr, cp * cr]])


def axle_positions(joint_angles: np.ndarray, rpy: np.ndarray, half_length: float) -> np.ndarray:
    """(n, 3) positions of the axles relative to the first one, z up, x along the head's heading [m]."""
    chain = ChainKinematics(len(joint_angles), half_length)
    return chain.positions(joint_angles)[::2] @ tilt_rotation(rpy).T


def belly_loads(pad_forces: np.ndarray) -> np.ndarray:
    """(2n,) forces of the belly pads, half by half from the head [N], out of `pad_forces` (4n,)."""
    return pad_forces.reshape(-1, len(PAD_PLACES))[:, :2].ravel()


def nearest_by_half(ranges: np.ndarray, units: int) -> np.ndarray:
    """(2n, 3) smallest range of each half to the belly's side, the left and the right [m], from `ranges`."""
    nearest: np.ndarray = ranges.reshape(2 * units, 3, -1).min(axis=2)
    return nearest


def half_poses(joint_angles: np.ndarray, rpy: np.ndarray, half_length: float) -> list[RigidTransform]:
    """Poses of the links F0, R0, F1, ... with z up and x along the head's heading; the first one at the origin.

    Args:
        joint_angles: (2n - 1,) [rad]; one that is not a number counts as straight.
        rpy: (3,) of the head by its IMU; the yaw, which drifts, is left out.
    """
    joint_angles = np.nan_to_num(joint_angles, posinf=0.0, neginf=0.0)
    chain = ChainKinematics(len(joint_angles), half_length)
    origins, _, _ = chain.joint_frames(joint_angles)
    R_HB = tilt_rotation(rpy)
    offset = np.array([-half_length, 0.0, 0.0])
    poses = [RigidTransform(RotationMatrix.ProjectToRotationMatrix(R_HB), np.zeros(3))]
    R = np.eye(3)
    for i, angle in enumerate(joint_angles):
        turn = RotationMatrix.MakeYRotation(angle) if i % 2 == 0 else RotationMatrix.MakeZRotation(angle)
        R = R @ turn.matrix()
        X_HL = RotationMatrix.ProjectToRotationMatrix(R_HB @ R)
        poses.append(RigidTransform(X_HL, R_HB @ (origins[i] + offset)))
    return poses
