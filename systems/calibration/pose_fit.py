"""Small changes of a camera's pose: how points move by them, which of them the data hold, and the verdict on a fit.

A change ξ = [w, t] of pose X_AB is made in B: X_AB ← X_AB (Exp(w), t), rotation first [rad], then translation [m].
"""

from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial.transform import Rotation

from ..config import quantity

MOTIONS = ("turn about x", "turn about y", "turn about z", "shift along x", "shift along y", "shift along z")
# Directions of which the data say nothing at all get a standard deviation this many times that of `HoldConfig`.
_UNKNOWN = 100.0


@dataclass(frozen=True, eq=False)
class Calibration:
    """Pose of a camera C, fixed or on a pan-tilt. Read-only: it is shared between ports, not copied.

    The camera's pose in the depth camera's frame D at pan and tilt is X_DC = X_DN [Rz(pan) Ry(tilt)] X_HC, with N the
    mount of the pan-tilt and H its head; see `camera_pose`. For a fixed camera pan and tilt are 0 and, with X_DN
    the identity, X_HC is X_DC.

    Attributes:
        X_HC: camera in the head, the guess where nothing better is known.
        X_DN: mount in the depth camera.
        covariance: of the change [w, t] of X_HC in the camera's axes, (6, 6) [rad, m]; (12, 12) when the mount was
            estimated too, the last six for the change of X_DN in the axes of N. Directions that the data do not hold
            have a large variance there.
        rms_px: root mean square distance of the inliers from where they should be [px]; infinite when there are none.
        inliers: number of pairs in the final fit.
        valid: whether there was enough to fit.
        reason: why it is not valid, or what else to know; "" when all is well.
    """

    X_HC: RigidTransform
    X_DN: RigidTransform
    covariance: np.ndarray
    rms_px: float
    inliers: int
    valid: bool
    reason: str

    def __deepcopy__(self, memo: dict) -> "Calibration":
        return self

    def camera_pose(self, pan: float = 0.0, tilt: float = 0.0) -> RigidTransform:
        """X_DC at `pan` (left +) and `tilt` (down +) [rad]."""
        R_NH = RotationMatrix(head_rotations(np.array([[pan, tilt]]))[0])
        return self.X_DN @ RigidTransform(R_NH, np.zeros(3)) @ self.X_HC


@dataclass(kw_only=True)
class HoldConfig:
    """When a direction of motion counts as measured: known better than from a tape measure and a spirit level."""

    # [deg], [m] A direction with a larger standard deviation, in multiples of these two, keeps the guess.
    max_std_deg: float = quantity(2.0, unit="deg", above=0)
    max_std: float = quantity(0.03, unit="m", above=0)

    def scale(self, size: int) -> np.ndarray:
        """The two limits as a vector for `size` = 6 or 12 unknowns [rad, m]."""
        return np.tile(np.repeat([np.deg2rad(self.max_std_deg), self.max_std], 3), size // 6)


def unfitted(X_HC: RigidTransform, X_DN: RigidTransform, size: int, hold: HoldConfig, reason: str) -> Calibration:
    """The guess, marked as not valid."""
    covariance = np.diag((_UNKNOWN * hold.scale(size)) ** 2)
    return Calibration(X_HC, X_DN, covariance, float("inf"), 0, False, reason)


def head_rotations(pan_tilt: np.ndarray) -> np.ndarray:
    """R_NH (V, 3, 3) = Rz(pan) Ry(tilt) of angles (V, 2) [rad]."""
    return np.asarray(Rotation.from_euler("ZY", np.asarray(pan_tilt, float).reshape(-1, 2)).as_matrix())


def changed(X_AB: RigidTransform, change: np.ndarray) -> RigidTransform:
    """X_AB (Exp(w), t)."""
    R = RotationMatrix.ProjectToRotationMatrix(Rotation.from_rotvec(change[:3]).as_matrix())
    return X_AB @ RigidTransform(R, change[3:])


def change_between(X_AB: RigidTransform, X_AB_new: RigidTransform) -> np.ndarray:
    """The [w, t] that `changed` needs to get from one pose to the other."""
    X = X_AB.inverse() @ X_AB_new
    return np.concatenate([Rotation.from_matrix(X.rotation().matrix()).as_rotvec(), X.translation()])


def point_jacobian(p_BP: np.ndarray) -> np.ndarray:
    """How fixed points (N, 3), given in B, move in B when X_AB changes: d p_BP / d[w, t] = [[p]×, −I], (N, 3, 6)."""
    J = np.zeros((len(p_BP), 3, 6))
    x, y, z = p_BP.T
    J[:, 0, 1], J[:, 0, 2], J[:, 1, 2] = -z, y, -x
    J[:, 1, 0], J[:, 2, 0], J[:, 2, 1] = z, -y, x
    J[:, [0, 1, 2], [3, 4, 5]] = -1
    return J


def ray_jacobian(p_CP: np.ndarray) -> np.ndarray:
    """d(x, y) / d p_CP of the ray's intersection with the plane z = 1, (N, 2, 3)."""
    inverse = 1 / p_CP[:, 2]
    J = np.zeros((len(p_CP), 2, 3))
    J[:, 0, 0] = J[:, 1, 1] = inverse
    J[:, 0, 2], J[:, 1, 2] = -p_CP[:, 0] * inverse**2, -p_CP[:, 1] * inverse**2
    return J


def held_directions(information: np.ndarray, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which directions are known better than `scale`.

    Args:
        information: inverse of the covariance, (K, K).
        scale: limits of `HoldConfig`, (K,).

    Returns:
        Eigenvalues of the information in units of the limits (1 is just at the limit), ascending, and the directions,
        columns of unit length in those units: the change is scale · (directions @ coordinates).
    """
    values, directions = np.linalg.eigh(scale[:, None] * information * scale)
    return values, directions


def covariance_of(information: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Inverse of the information; directions without any get 100 times `scale` as their standard deviation."""
    values, directions = held_directions(information, scale)
    scaled = scale[:, None] * directions
    return np.asarray((scaled / np.maximum(values, _UNKNOWN**-2)) @ scaled.T)


def unheld_in_words(values: np.ndarray, directions: np.ndarray) -> str:
    """What a user is told about directions that are not held, "" when all are."""
    free = sorted({int(np.abs(directions[:, i]).argmax()) for i in np.flatnonzero(values < 1)})
    if not free:
        return ""
    names = [MOTIONS[i % 6] + (" of the mount" if i >= 6 else "") for i in free]
    return f"the data do not hold {', '.join(names)}: taken from the guess"
