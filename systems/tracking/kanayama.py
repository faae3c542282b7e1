"""Kanayama's stable tracking law for a non-holonomic robot, slower where it is risky (row S3-d, Eq. 8 and 9)."""

from dataclasses import dataclass, replace

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from ..config import check_config, quantity
from ..ports import eval_typed


@dataclass(kw_only=True)
class KanayamaConfig:
    """Gains and limits of the tracking law."""

    # Longitudinal gain [1/s].
    k_x: float = quantity(1.0, unit="1/s", low=0)
    # Lateral gain [1/m²]; with k_theta = 2 sqrt(k_y) the linearised error is critically damped.
    k_y: float = quantity(4.0, unit="1/m²", low=0)
    # Heading gain [1/m].
    k_theta: float = quantity(4.0, unit="1/m", low=0)
    # Largest forward speed that is commanded [m/s].
    max_speed: float = quantity(0.3, unit="m/s", above=0)
    # Largest yaw rate that is commanded [rad/s].
    max_yaw_rate: float = quantity(0.8, unit="rad/s", above=0)
    # r_limit of Eq. 9 [-]: with it the system has the port `risk` and K_x falls with the risk; without, K_x is fixed.
    risk_limit: float | None = quantity(None, unit="-", above=0)
    # Share of K_x that is left at and above r_limit [-]: with none a robot would stop before its sub-goal for ever.
    min_gain_share: float = quantity(0.1, unit="-", above=0, high=1)


def planar_pose(X_MB: RigidTransform) -> np.ndarray:
    """Returns (x, y, heading) [m, m, rad]: the position and the direction of the x axis seen from above."""
    forward = X_MB.rotation().matrix()[:, 0]
    x, y, _ = X_MB.translation()
    return np.array([x, y, np.arctan2(forward[1], forward[0])])


def pose_error(pose: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Returns (x_e, y_e, theta_e): the reference seen from the robot [m, m, rad], theta_e in (-pi, pi].

    Args:
        pose, reference: (3,) x, y, heading in one frame [m, m, rad].
    """
    dx, dy, dtheta = reference - pose
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array([c * dx + s * dy, -s * dx + c * dy, np.arctan2(np.sin(dtheta), np.cos(dtheta))])


def kanayama_law(error: np.ndarray, v_r: float, omega_r: float, config: KanayamaConfig) -> np.ndarray:
    """Eq. 8: v = v_r cos(theta_e) + K_x x_e, omega = omega_r + v_r (K_y y_e + K_theta sin(theta_e)).

    Args:
        error: (3,) as `pose_error` gives it.
        v_r, omega_r: reference speed [m/s] and yaw rate [rad/s].

    Returns:
        (2,) v [m/s] and omega [rad/s], scaled down together so that both limits hold and the curvature is kept.
    """
    x_e, y_e, theta_e = error
    v = v_r * np.cos(theta_e) + config.k_x * x_e
    omega = omega_r + v_r * (config.k_y * y_e + config.k_theta * np.sin(theta_e))
    return np.array([v, omega]) / max(1.0, abs(v) / config.max_speed, abs(omega) / config.max_yaw_rate)


def gain_share(risk: float, risk_limit: float, min_share: float) -> float:
    """Eq. 9 as a share, K_x / K̂_x = 1 - r / r_limit, within [min_share, 1]; `min_share` where the risk is not known."""
    return min(1.0, max(min_share, 1.0 - risk / risk_limit))


class KanayamaTracking(LeafSystem):
    """
    .. pydrake_system::

        name: KanayamaTracking
        input_ports:
        - X_MB
        - reference_pose
        - reference_twist
        - risk
        output_ports:
        - twist_command

    Steers a robot at `X_MB` (RigidTransform, robot base B in map M) to the moving reference by Kanayama's law
    (row S3-d, Eq. 8; stable for v_r > 0 by the Lyapunov function of Kanayama et al. 1990). The motion on the ground is
    planar: on a slope the position is its projection and the heading the direction of the x axis seen from above.

    - `reference_pose` (3): x, y, heading in M [m, m, rad].
    - `reference_twist` (2): v_r [m/s], omega_r [rad/s].
    - `risk` (1), optional, there when the configuration has a `risk_limit`: risk r of the ground that the reference is
      on. K_x is then that of Eq. 9, K̂_x (1 - r / r_limit), but at least `min_gain_share` of K̂_x.
    - `twist_command` (2): v [m/s], omega [rad/s]; within the limits of the configuration.

    With v_r = 0 the law only closes x_e: it neither turns nor orbits, and y_e and theta_e stay. So a reference that
    slows down towards a goal ends in rest. With a reference that is kept d ahead, as the sub-goals of S3-c are, the
    robot drives at v_r + K_x d. Choose K̂_x = (max_speed - v_r) / d: with more, saturation hides Eq. 9.

    Raises `PortError` when `X_MB` is not a RigidTransform and `ConfigError` on gains out of range.
    """

    def __init__(self, config: KanayamaConfig):
        super().__init__()
        check_config(config, key="kanayama")
        self._config = config
        self.DeclareAbstractInputPort("X_MB", AbstractValue.Make(RigidTransform()))
        self.DeclareVectorInputPort("reference_pose", 3)
        self.DeclareVectorInputPort("reference_twist", 2)
        if config.risk_limit is not None:
            self.DeclareVectorInputPort("risk", 1)
        self.DeclareVectorOutputPort("twist_command", 2, self._CalcTwistCommand)

    def _CalcTwistCommand(self, context: Context, output: BasicVector) -> None:
        pose = planar_pose(eval_typed(self, context, "X_MB", RigidTransform))
        v_r, omega_r = eval_typed(self, context, "reference_twist", np.ndarray)
        error = pose_error(pose, eval_typed(self, context, "reference_pose", np.ndarray))
        config = self._config
        if config.risk_limit is not None:
            risk = float(eval_typed(self, context, "risk", np.ndarray)[0])
            config = replace(config, k_x=config.k_x * gain_share(risk, config.risk_limit, config.min_gain_share))
        output.SetFromVector(kanayama_law(error, v_r, omega_r, config))
