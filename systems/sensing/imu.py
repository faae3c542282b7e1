"""Simulated inertial measurement unit with the orientation filter that is built into such units."""

import math
from dataclasses import dataclass

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialAcceleration, SpatialVelocity
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from ..config import check_config, quantity
from ..errors import ConfigError
from ..noise import generator_at
from ..ports import eval_typed


@dataclass(kw_only=True)
class ImuConfig:
    """A MEMS unit of the price class that small robots carry. Values are assumed, typical of industrial-grade parts."""

    # Time between samples.
    period: float = quantity(0.01, unit="s", above=0.0)
    # White noise of the gyroscopes.
    gyro_noise_density: float = quantity(1e-4, unit="rad/s/√Hz", low=0.0)
    # Standard deviation of the constant bias drawn at the start of a run; this is what makes yaw drift.
    gyro_bias: float = quantity(5e-4, unit="rad/s", low=0.0)
    # Random walk of the bias.
    gyro_bias_walk: float = quantity(2e-6, unit="rad/s/√s", low=0.0)
    # White noise of the accelerometers.
    accelerometer_noise_density: float = quantity(1e-3, unit="m/s²/√Hz", low=0.0)
    # Standard deviation of their constant bias.
    accelerometer_bias: float = quantity(0.02, unit="m/s²", low=0.0)
    # Rate at which tilt is pulled to the measured vertical; slow, so that driving does not tilt it.
    filter_gain: float = quantity(0.2, unit="1/s", low=0.0)
    # The pull is off while the specific force differs from gravity by more than this share: the robot accelerates.
    filter_gate: float = quantity(0.1, above=0.0)
    # For so long after the first sample the gain is 1/t, if that is higher: the mean of what was measured so far, since
    # the first sample alone is one of a robot that still rocks.
    alignment_time: float = quantity(1.0, unit="s", low=0.0)


def specific_force(R_WI: np.ndarray, a_WI_W: np.ndarray, gravity_W: np.ndarray) -> np.ndarray:
    """What an ideal accelerometer reads, (3) [m/s²] in I: Rᵀ (a − g). At rest it points up."""
    return R_WI.T @ (a_WI_W - gravity_W)


def rotation_increment(w_before: np.ndarray, w_now: np.ndarray, dt: float) -> np.ndarray:
    """Rotation vector (3) [rad] over a time step between two samples of the body rate.

    φ = ½ (ω₀ + ω₁) dt + (ω₀ × ω₁) dt²/6. Half of the cross product is the second term of the Magnus series for a rate
    that changes linearly, the other half makes up for what the mean of two samples loses of a rate that turns. So
    coning, an axis that shakes around a cone as on a vibrating robot, does not make the attitude drift (J. Bortz, A
    new mathematical formulation for strapdown inertial navigation, IEEE TAES 1971, states the effect).
    """
    return 0.5 * dt * (w_before + w_now) + (dt * dt / 6) * _cross(w_before, w_now)


def rotate(quaternion: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Turns unit quaternion (w, x, y, z) by a rotation vector in the body frame: q ⊗ exp(φ/2), normalised."""
    w, x, y, z = quaternion
    a, b, c = rotation
    half = 0.5 * math.sqrt(a * a + b * b + c * c)
    scale = 0.5 * (math.sin(half) / half if half > 1e-8 else 1.0)
    d, a, b, c = math.cos(half), a * scale, b * scale, c * scale
    turned = np.array(
        [
            w * d - x * a - y * b - z * c,
            w * a + x * d + y * c - z * b,
            w * b - x * c + y * d + z * a,
            w * c + x * b - y * a + z * d,
        ]
    )
    return turned / math.sqrt(turned @ turned)


def mahony_step(
    quaternion: np.ndarray,
    w_before: np.ndarray,
    w_now: np.ndarray,
    force: np.ndarray,
    dt: float,
    *,
    gain: float,
    gate: float,
    gravity: float,
) -> np.ndarray:
    """One step of the explicit complementary filter, without bias estimate.

    Mahony, Hamel and Pflimlin, Nonlinear complementary filters on the special orthogonal group, IEEE TAC 2008, Eq. 32:
    the estimate turns at ω + k (f̂ × v̂), where f̂ is the direction of the measured specific force and v̂ that of the
    estimated vertical. The correction is at right angles to v̂, so that yaw comes from the gyroscope alone.

    Args:
        quaternion: estimate of R_WI as (w, x, y, z).
        w_before, w_now: measured body rates at the last and at this sample, (3) [rad/s].
        force: measured specific force (3) [m/s²].
        gain: k [1/s]. gate: largest share by which |force| may differ from `gravity` [m/s²].

    Returns:
        The estimate at this sample.
    """
    turned = rotate(quaternion, rotation_increment(w_before, w_now, dt))
    norm = math.sqrt(force @ force)
    if norm == 0.0 or abs(norm / gravity - 1) > gate:
        return turned
    w, x, y, z = turned
    vertical = np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
    return rotate(turned, (gain * dt / norm) * _cross(force, vertical))


def align(force: np.ndarray, yaw: float) -> np.ndarray:
    """Orientation (w, x, y, z) of a unit at rest whose accelerometers read `force`, with the yaw that is given."""
    roll = math.atan2(force[1], force[2])
    pitch = math.atan2(-force[0], math.hypot(force[1], force[2]))
    quaternion = np.array([1.0, 0.0, 0.0, 0.0])
    for turn in ([0.0, 0.0, yaw], [0.0, pitch, 0.0], [roll, 0.0, 0.0]):
        quaternion = rotate(quaternion, np.array(turn))
    return quaternion


def roll_pitch_yaw(quaternion: np.ndarray) -> np.ndarray:
    """Roll, pitch, yaw (3) [rad] of R = Rz(yaw) Ry(pitch) Rx(roll)."""
    w, x, y, z = quaternion
    return np.array(
        [
            math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
            math.asin(max(-1.0, min(1.0, 2 * (w * y - x * z)))),
            math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
        ]
    )


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    # numpy.cross takes more than ten times as long for two single vectors.
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


# Layout of the discrete state.
_GYRO, _FORCE, _QUATERNION = slice(0, 3), slice(3, 6), slice(6, 10)
_GYRO_BIAS, _FORCE_BIAS, _SAMPLES = slice(10, 13), slice(13, 16), 16
# Number of samples since the alignment began; 0 before it.
_ALIGNED = 17


class Imu(LeafSystem):
    """
    .. pydrake_system::

        name: Imu
        input_ports:
        - body_poses
        - body_spatial_velocities
        - body_spatial_accelerations
        output_ports:
        - gyro
        - accelerometer
        - rpy

    Inertial measurement unit in frame I, fixed to body B. The inputs `body_poses`, `body_spatial_velocities` and
    `body_spatial_accelerations` are the MultibodyPlant's output ports of these names.

    `gyro` (3) [rad/s] and `accelerometer` (3) [m/s²] are the angular velocity and the specific force in I, with white
    noise of standard deviation density/√period and with biases: a constant one drawn at the start of a run and, for
    the gyroscopes, a random walk. `rpy` (3) [rad] is the unit's own estimate of R_WI = Rz Ry Rx from these
    measurements alone (`mahony_step`): tilt is pulled to the measured vertical, yaw is the integral of the gyroscopes
    from `initial_yaw` and drifts with their bias.

    All three are sampled every period from t = 0 on and held between. The first sample aligns roll and pitch with the
    measured specific force, those of the next `alignment_time` with their mean, so a run should start at rest and stay
    so for that long; a robot that falls, whose specific force is more than a tenth from gravity, is aligned from its
    first sample at rest on. Before the first sample, gyro and accelerometer
    are zero and `rpy` is (0, 0, initial_yaw).

    Args:
        config: noise and filter.
        body_index: body B that the unit is fixed to.
        X_BI: pose of the unit in B.
        gravity: gravity vector in W (3) [m/s²], `plant.gravity_field().gravity_vector()`; it must point down.
        seed: of biases and noise; two runs with one seed are equal.
        initial_yaw: [rad].

    Raises:
        ConfigError: a value of `config` is out of range, or gravity does not point down.
        PortError: an input is not connected.
    """

    def __init__(
        self,
        config: ImuConfig,
        *,
        body_index: BodyIndex,
        X_BI: RigidTransform | None = None,
        gravity: np.ndarray | None = None,
        seed: int = 0,
        initial_yaw: float = 0.0,
    ):
        super().__init__()
        check_config(config, where="imu")
        self.config = config
        self._body = int(body_index)
        X_BI = RigidTransform() if X_BI is None else X_BI
        self._R_BI, self._p_BI = X_BI.rotation().matrix(), X_BI.translation()
        self._gravity_W = np.array([0.0, 0.0, -9.81]) if gravity is None else np.asarray(gravity, float)
        if self._gravity_W.shape != (3,) or not self._gravity_W[2] < -1e-3 or np.any(self._gravity_W[:2] != 0):
            valid = "a vector (0, 0, -g)"
            raise ConfigError("gravity does not point down", where="imu", value=self._gravity_W.tolist(), valid=valid)
        self._initial_yaw = initial_yaw

        types = (RigidTransform, SpatialVelocity, SpatialAcceleration)
        names = ("body_poses", "body_spatial_velocities", "body_spatial_accelerations")
        for name, entry in zip(names, types, strict=True):
            self.DeclareAbstractInputPort(name, AbstractValue.Make([entry()]))
        self._seed = seed
        rng = generator_at(seed, 0)
        start = np.zeros(18)
        start[_QUATERNION] = rotate(np.array([1.0, 0, 0, 0]), np.array([0.0, 0.0, initial_yaw]))
        start[_GYRO_BIAS] = config.gyro_bias * rng.standard_normal(3)
        start[_FORCE_BIAS] = config.accelerometer_bias * rng.standard_normal(3)
        self.DeclareDiscreteState(start)
        ticket = {self.xd_ticket()}
        self.DeclareVectorOutputPort("gyro", 3, self._CalcGyro, ticket)
        self.DeclareVectorOutputPort("accelerometer", 3, self._CalcAccelerometer, ticket)
        self.DeclareVectorOutputPort("rpy", 3, self._CalcRpy, ticket)
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, 0.0, self._Sample)

    def _CalcGyro(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state_vector().value()[_GYRO])

    def _CalcAccelerometer(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state_vector().value()[_FORCE])

    def _CalcRpy(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(roll_pitch_yaw(context.get_discrete_state_vector().value()[_QUATERNION]))

    def _Sample(self, context: Context, discrete_state: DiscreteValues) -> None:
        config = self.config
        X_WB = eval_typed(self, context, "body_poses", list)[self._body]
        V_WB = eval_typed(self, context, "body_spatial_velocities", list)[self._body]
        A_WB = eval_typed(self, context, "body_spatial_accelerations", list)[self._body]
        R_WB = X_WB.rotation().matrix()
        R_WI = R_WB @ self._R_BI
        a_WI_W = A_WB.Shift(R_WB @ self._p_BI, V_WB.rotational()).translational()

        x = context.get_discrete_state_vector().value().copy()
        noise = generator_at(self._seed, int(x[_SAMPLES]) + 1).standard_normal((3, 3))
        w_before = x[_GYRO].copy()
        per_root_hertz = config.period**-0.5
        x[_GYRO_BIAS] += config.gyro_bias_walk * config.period**0.5 * noise[0]
        x[_GYRO] = R_WI.T @ V_WB.rotational() + x[_GYRO_BIAS] + config.gyro_noise_density * per_root_hertz * noise[1]
        x[_FORCE] = specific_force(R_WI, a_WI_W, self._gravity_W) + x[_FORCE_BIAS]
        x[_FORCE] += config.accelerometer_noise_density * per_root_hertz * noise[2]
        weightless = abs(np.linalg.norm(x[_FORCE]) + self._gravity_W[2]) > 0.1 * -self._gravity_W[2]
        if not x[_ALIGNED] and not weightless:
            x[_QUATERNION] = align(x[_FORCE], self._initial_yaw)
            x[_ALIGNED] = 1
        else:
            gain, aligned = config.filter_gain, x[_ALIGNED] * config.period
            if x[_ALIGNED]:
                x[_ALIGNED] += 1
                if aligned < config.alignment_time:
                    gain = max(gain, 1 / (aligned + config.period))
            x[_QUATERNION] = mahony_step(
                x[_QUATERNION],
                w_before,
                x[_GYRO],
                x[_FORCE],
                config.period,
                gain=gain,
                gate=config.filter_gate,
                gravity=-self._gravity_W[2],
            )
        x[_SAMPLES] += 1
        discrete_state.set_value(x)
