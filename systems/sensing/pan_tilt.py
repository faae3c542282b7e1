"""Pan-tilt unit: two axes that turn at a limited rate, with encoders."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from ..config import check_config, quantity
from ..errors import ConfigError, PortError
from ..noise import generator_at
from .camera_model import R_OPTICAL


@dataclass(kw_only=True)
class PanTiltConfig:
    """A small unit that carries a camera. Values are assumed, typical of units for cameras of up to 3 kg."""

    # Lowest and highest pan angle, left is positive.
    pan_range_deg: list[float] = quantity([-60.0, 60.0], unit="deg", low=-180.0, high=180.0)
    # Lowest and highest tilt angle, down is positive.
    tilt_range_deg: list[float] = quantity([-30.0, 60.0], unit="deg", low=-89.0, high=89.0)
    # Highest rate of each axis. Acceleration is not modelled.
    max_rate: float = quantity(1.0, unit="rad/s", above=0.0)
    # Step of the encoders: 14 bits a turn.
    resolution: float = quantity(2 * np.pi / 2**14, unit="rad", above=0.0)
    # Standard deviation of an encoder reading.
    noise: float = quantity(2e-4, unit="rad", low=0.0)
    # Time between two commands, and between two readings.
    period: float = quantity(0.02, unit="s", above=0.0)

    def limits(self) -> np.ndarray:
        """Lowest and highest angles [[pan, tilt], [pan, tilt]] [rad]. Raises `ConfigError` when a range is empty."""
        for name in ("pan_range_deg", "tilt_range_deg"):
            value = getattr(self, name)
            if len(value) != 2 or not value[0] < value[1]:
                raise ConfigError("range", where="pan-tilt", key=name, value=value, valid="[lowest, highest]")
        return np.deg2rad([self.pan_range_deg, self.tilt_range_deg]).T


def pan_tilt_pose(angles: np.ndarray | tuple[float, float], X_HC: RigidTransform | None = None) -> RigidTransform:
    """Pose X_NC of a camera on a pan-tilt unit.

    X_NC = X_NH X_HC, with X_NH = Rz(pan) Ry(tilt) about the origin of the mount N. N and the head H have x forward,
    y left and z up, and agree when both angles are 0.

    Args:
        angles: pan, left is positive, and tilt, down is positive [rad].
        X_HC: pose of the camera in the head; at its origin, looking forward, when not given.
    """
    pan, tilt = angles
    R_NH = RotationMatrix.MakeZRotation(pan) @ RotationMatrix.MakeYRotation(tilt)
    return RigidTransform(R_NH) @ (RigidTransform(R_OPTICAL) if X_HC is None else X_HC)


def turn(angles: np.ndarray, target: np.ndarray, max_rate: float, dt: float) -> np.ndarray:
    """Angles [rad] after `dt` [s] at `max_rate` [rad/s] towards `target`, each axis on its own; none overshoots."""
    way = max_rate * max(dt, 0.0)
    return angles + np.clip(target - angles, -way, way)


# Layout of the discrete state: where the axes were at `_TIME`, where they are going, and what was read there.
_ANGLES, _TARGET, _READING, _TIME, _OUT_OF_RANGE, _SAMPLES = slice(0, 2), slice(2, 4), slice(4, 6), 6, 7, 8


class PanTilt(LeafSystem):
    """
    .. pydrake_system::

        name: PanTilt
        input_ports:
        - pan_tilt_command
        output_ports:
        - pan_tilt_angles
        - out_of_range
        - cheat.pan_tilt_angles

    Pan-tilt unit of two axes, for the pose of its camera see `pan_tilt_pose`. Every period it takes a command and reads
    its encoders; between, each axis turns at `max_rate` until it is where it should be, without overshoot.

    - `pan_tilt_command` (2) [rad]: pan, left is positive, and tilt, down is positive. A command outside the range is
      cut to it. Where it is not finite the axis stops and holds its position.
    - `pan_tilt_angles` (2) [rad]: what the encoders read at the last period, with noise, in steps of the resolution.
    - `out_of_range` (1): 1 while the command cannot be followed as it is, because it is outside the range or not
      finite; else 0.
    - `cheat.pan_tilt_angles` (2) [rad]: true angles at any time.

    Args:
        config: ranges, rate and encoders.
        angles: pan and tilt at the start [rad]; as near to 0 as the ranges allow when not given.
        seed: of the encoders' noise; two runs with one seed are equal.

    Raises:
        ConfigError: a value of `config` is out of its range, a range is empty, or `angles` are outside.
        PortError: `pan_tilt_command` is not connected.
    """

    def __init__(self, config: PanTiltConfig | None = None, *, angles: np.ndarray | None = None, seed: int = 0):
        super().__init__()
        self.config = PanTiltConfig() if config is None else config
        check_config(self.config, where="pan-tilt")
        self._low, self._high = self.config.limits()
        start = np.zeros(9)
        start[_ANGLES] = np.clip(0.0, self._low, self._high) if angles is None else angles
        if not np.all((start[_ANGLES] >= self._low) & (start[_ANGLES] <= self._high)):
            valid = f"pan {self.config.pan_range_deg} deg, tilt {self.config.tilt_range_deg} deg"
            raise ConfigError("start out of range [rad]", where="pan-tilt", value=start[_ANGLES].tolist(), valid=valid)
        start[_TARGET] = start[_ANGLES]
        start[_READING] = self._read(start[_ANGLES])
        self._seed = seed
        self.DeclareVectorInputPort("pan_tilt_command", 2)
        self.DeclareDiscreteState(start)
        self.DeclarePeriodicDiscreteUpdateEvent(self.config.period, 0.0, self._Update)
        state = self.xd_ticket()
        self.DeclareVectorOutputPort("pan_tilt_angles", 2, self._CalcReading, {state})
        self.DeclareVectorOutputPort("out_of_range", 1, self._CalcOutOfRange, {state})
        self.DeclareVectorOutputPort("cheat.pan_tilt_angles", 2, self._CalcAngles, {state, self.time_ticket()})

    def angles(self, context: Context) -> np.ndarray:
        """True pan and tilt [rad]."""
        x = context.get_discrete_state_vector().value()
        return turn(x[_ANGLES], x[_TARGET], self.config.max_rate, context.get_time() - x[_TIME])

    def _read(self, angles: np.ndarray) -> np.ndarray:
        return np.rint(angles / self.config.resolution) * self.config.resolution

    def _Update(self, context: Context, discrete_state: DiscreteValues) -> None:
        port = self.GetInputPort("pan_tilt_command")
        if not port.HasValue(context):
            raise PortError("input port is not connected", where="PanTilt.pan_tilt_command", valid="pan and tilt [rad]")
        command: Any = port.Eval(context)
        x = context.get_discrete_state_vector().value().copy()
        x[_ANGLES] = self.angles(context)
        x[_TARGET] = np.where(np.isfinite(command), np.clip(command, self._low, self._high), x[_ANGLES])
        x[_OUT_OF_RANGE] = not np.array_equal(command, x[_TARGET])
        noise = generator_at(self._seed, int(x[_SAMPLES])).standard_normal(2)
        x[_READING] = self._read(x[_ANGLES] + self.config.noise * noise)
        x[_TIME] = context.get_time()
        x[_SAMPLES] += 1
        discrete_state.set_value(x)

    def _CalcReading(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state_vector().value()[_READING])

    def _CalcOutOfRange(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state_vector().value()[_OUT_OF_RANGE : _OUT_OF_RANGE + 1])

    def _CalcAngles(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self.angles(context))
