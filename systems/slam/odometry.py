"""6-DoF odometry from track encoders and an IMU (row S0-e)."""

from dataclasses import dataclass

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from ..config import check_config, quantity
from ..errors import PortError
from ..ports import weak_method


@dataclass(kw_only=True)
class OdometryConfig:
    """When the odometry reads its sensors."""

    # [s] Period of an update; shorter follows curves better.
    period: float = quantity(0.02, unit="s", above=0)


def rotation(psi: float, theta: float, phi: float) -> np.ndarray:
    """R = Rz(φ) Ry(θ) Rx(ψ) of roll ψ, pitch θ and yaw φ [rad], (3, 3): Eq. 6."""
    s_psi, c_psi = np.sin(psi), np.cos(psi)
    s_theta, c_theta = np.sin(theta), np.cos(theta)
    s_phi, c_phi = np.sin(phi), np.cos(phi)
    return np.array(
        [
            [c_phi * c_theta, c_phi * s_theta * s_psi - s_phi * c_psi, c_phi * s_theta * c_psi + s_phi * s_psi],
            [s_phi * c_theta, s_phi * s_theta * s_psi + c_phi * c_psi, s_phi * s_theta * c_psi - c_phi * s_psi],
            [-s_theta, c_theta * s_psi, c_theta * c_psi],
        ]
    )


def propagate(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Motion model x_t = x_{t−1} + T u_t, Eq. 4 and 5: the translation is turned by R at the mid-angles.

    The paper prints the same model again as Eq. 3, where two terms of the row of y disagree with Eq. 5 and 6: the
    factor of Δy reads c_φ s_θ s_ψ − s_φ c_ψ for s_φ s_θ s_ψ + c_φ c_ψ (it repeats the row of x), and that
    of Δz has s_φ s_ψ for c_φ s_ψ. With them R would not be a rotation; this follows Eq. 5 and 6.

    Args:
        x: [x y z ψ θ φ], position [m], roll, pitch and yaw [rad], (6,).
        u: [Δx Δy Δz Δψ Δθ Δφ], translation in the robot frame [m] and changes of the angles [rad], (6,).

    Returns:
        The state after it, (6,); angles are not wrapped.
    """
    x, u = np.asarray(x, float), np.asarray(u, float)
    psi, theta, phi = x[3:] + 0.5 * u[3:]
    return x + np.concatenate([rotation(psi, theta, phi) @ u[:3], u[3:]])


class Odometry6Dof(LeafSystem):
    """
    .. pydrake_system::

        name: Odometry6Dof
        input_ports:
        - track_displacements
        - rpy
        output_ports:
        - X_OB
        - state

    Dead reckoning of a tracked robot in six degrees of freedom, Eq. 2–6 of row S0-e, see `propagate`.

    Every `period` it reads `track_displacements` (2), the way that the left and the right track have made since they
    were switched on [m], and `rpy` (3), roll ψ, pitch θ and yaw φ as the IMU estimates them [rad]. Of the changes since
    the last reading, Δx is the mean of the tracks, Δψ, Δθ and Δφ are those of the IMU, taken the short way round, and
    Δy = Δz = 0. The paper names encoders as a second source of Δφ; tracks slip when they turn, so it is not used.
    The first update only takes the readings; before it, the outputs say the initial pose.

    - `X_OB` (`RigidTransform`): pose of the robot base B in the odometry frame O at the last update.
    - `state` (6): [x y z ψ θ φ] [m, rad]; the angles are not wrapped.

    Drift is what it leaves to scan matching: slip, and turning in place about a point that is not B, go unnoticed.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PortError: an input is not connected.
    """

    def __init__(self, config: OdometryConfig | None = None, X_OB0: RigidTransform | None = None):
        """
        Args:
            X_OB0: pose of the base at the start; identity when not given.
        """
        super().__init__()
        config = config or OdometryConfig()
        check_config(config)
        X_OB0 = X_OB0 or RigidTransform()
        self.DeclareVectorInputPort("track_displacements", 2)
        self.DeclareVectorInputPort("rpy", 3)
        start = np.concatenate([X_OB0.translation(), RollPitchYaw(X_OB0.rotation()).vector()])
        pose = self.DeclareDiscreteState(start)
        # The last readings, left, right, roll, pitch, yaw, and whether there are any.
        readings = self.DeclareDiscreteState(6)
        self._pose, self._readings = int(pose), int(readings)
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, 0.0, self._Update)
        ticket = self.discrete_state_ticket(pose)
        self.DeclareAbstractOutputPort(
            "X_OB", lambda: AbstractValue.Make(RigidTransform()), weak_method(self._CalcPose), {ticket}
        )
        self.DeclareVectorOutputPort("state", 6, self._CalcState, {ticket})

    def _Update(self, context: Context, discrete_state: DiscreteValues) -> None:
        tracks = _vector_input(self, context, "track_displacements")
        rpy = _vector_input(self, context, "rpy")
        last = context.get_discrete_state(self._readings).value()
        if last[5]:
            u = np.zeros(6)
            u[0] = np.mean(tracks - last[:2])
            u[3:] = wrap(rpy - last[2:5])
            x = context.get_discrete_state(self._pose).value()
            discrete_state.set_value(self._pose, propagate(x, u))
        discrete_state.set_value(self._readings, np.concatenate([tracks, rpy, [1.0]]))

    def _CalcPose(self, context: Context, output: AbstractValue) -> None:
        x = context.get_discrete_state(self._pose).value()
        output.set_value(RigidTransform(RotationMatrix(rotation(*x[3:])), x[:3]))

    def _CalcState(self, context: Context, output: BasicVector) -> None:
        output.set_value(context.get_discrete_state(self._pose).value())


def _vector_input(system: LeafSystem, context: Context, name: str) -> np.ndarray:
    port = system.GetInputPort(name)
    if not port.HasValue(context):
        raise PortError("input port is not connected", where=f"{type(system).__name__}.{name}")
    return np.asarray(port.Eval(context))


def wrap(angles: np.ndarray) -> np.ndarray:
    """Angles [rad] brought into [−π, π)."""
    return (np.asarray(angles, float) + np.pi) % (2 * np.pi) - np.pi
