"""Kinematics of a part of the snake as a redundant arm (row S1-a)."""

from dataclasses import dataclass

import numpy as np

from ..errors import ConfigError
from .chain_kernels import add_distance_gradient, add_manipulability_gradient, fill_jacobian, forward
from .chain_kernels import jacobian_derivative as _jacobian_derivative


@dataclass(frozen=True)
class ChainKinematics:
    """A chain of `joints` joints, pitch and yaw in turn, `half_length` [m] apart.

    Angles are (m,) [rad] from the head side on. The reference frame A has its origin at the first joint and the axes
    of the link before it (x ahead, y left, z up); the control frame C its origin at the last joint and the axes of the
    link behind it. A positive pitch angle raises the tail side, a positive yaw angle turns it to the right.
    """

    joints: int
    half_length: float
    starts_with_yaw: bool = False

    def __post_init__(self) -> None:
        if self.joints < 1:
            raise ConfigError("a chain needs joints", key="joints", value=self.joints, valid=">= 1")
        if not (np.isfinite(self.half_length) and self.half_length > 0):
            raise ConfigError("out of range", key="half_length", value=self.half_length, valid="> 0 m")

    def joint_frames(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Origins (m, 3) [m] and axes (m, 3) of the joints in A, and R_AC (3, 3).

        Raises:
            ConfigError: `theta` has another length.
        """
        theta = np.ascontiguousarray(theta, dtype=float)
        if theta.shape != (self.joints,):
            raise ConfigError("wrong number of joint angles", key="theta", value=theta.shape, valid=f"({self.joints},)")
        origins, axes, R_AC = np.empty((self.joints, 3)), np.empty((self.joints, 3)), np.eye(3)
        forward(theta, self.half_length, self.starts_with_yaw, origins, axes, R_AC)
        return origins, axes, R_AC

    def positions(self, theta: np.ndarray) -> np.ndarray:
        """Origins (m, 3) of the joints in A [m]."""
        return self.joint_frames(theta)[0]

    def control_pose(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """R_AC (3, 3) and p_AC (3,) [m]."""
        origins, _, R_AC = self.joint_frames(theta)
        return R_AC, origins[-1]

    def jacobian(self, theta: np.ndarray) -> np.ndarray:
        """J (6, m) with (v_AC, ω_AC) = J θ̇, both in A [m/s, rad/s]."""
        origins, axes, _ = self.joint_frames(theta)
        J = np.empty((6, self.joints))
        fill_jacobian(origins, axes, J)
        return J

    def jacobian_derivative(self, theta: np.ndarray) -> np.ndarray:
        """∂J[r, i]/∂θ_j (6, m, m)."""
        return _jacobian_derivative(self.jacobian(theta))

    def manipulability(self, theta: np.ndarray) -> float:
        """√det(J Jᵀ) [m³]: zero in a singular pose, such as the straight one."""
        J = self.jacobian(theta)
        return float(np.sqrt(max(np.linalg.det(J @ J.T), 0.0)))

    def log_manipulability_gradient(self, theta: np.ndarray) -> np.ndarray:
        """∂ log det(J Jᵀ)/∂θ (m,); grows without bound towards a singular pose."""
        J = self.jacobian(theta)
        gradient = np.zeros(self.joints)
        add_manipulability_gradient(J, np.ascontiguousarray(np.linalg.pinv(J)), 1.0, gradient)
        return gradient

    def distance_gradient(self, theta: np.ndarray, middle: int, target: np.ndarray) -> np.ndarray:
        """∂d²/∂θ (m,) [m²], with d the distance of the origin of joint `middle` from `target` (3,) in A [m]."""
        origins, axes, _ = self.joint_frames(theta)
        gradient = np.zeros(self.joints)
        add_distance_gradient(origins, axes, middle, np.asarray(target, dtype=float), 1.0, gradient)
        return gradient
