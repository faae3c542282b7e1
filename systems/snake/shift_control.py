"""Drives the whole snake along a path in space by shift control."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, EventStatus, LeafSystem, State

from ..config import check_config, quantity
from ..ports import eval_typed
from .body_path import BodyPath, BodyShape, fit_shape
from .snake_body import SnakeBody


@dataclass(kw_only=True)
class ShiftControlConfig:
    """How the body follows its path."""

    # Time between two samples.
    period: float = quantity(0.01, unit="s", above=0.0)
    # Largest speed along the path.
    max_speed: float = quantity(0.3, unit="m/s", above=0.0)
    # What the shape goes on by: the speed command, or what the wheels measure.
    progress: str = quantity("commanded", choices=("commanded", "measured"))
    # Quantile of the wheels' speeds that is taken as measured: low, because wheels in the air spin freely.
    wheel_quantile: float = quantity(0.1, low=0.0, high=1.0)


NO_PATH = BodyPath(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), 0.0, number=-1)
"""Stands for no path: the body stays as it is."""


def rolling_rates(before: BodyShape, after: BodyShape, dt: float, body: SnakeBody) -> np.ndarray:
    """Rates (2n,) [rad/s] with which the wheels roll, left and right of unit 0, of unit 1, ..., between two shapes.

    Speed of the axle along the link in front of it over the radius, less the link's own pitch rate; the two wheels of
    a pair differ by its yaw rate.
    """
    R = after.frames
    speed = np.einsum("ni,ni->n", after.axles - before.axles, R[:, :, 0]) / dt
    turned = (R[:, :, 0] - before.frames[:, :, 0]) / dt
    yaw_rate = np.einsum("ni,ni->n", turned, R[:, :, 1])
    pitch_rate = -np.einsum("ni,ni->n", turned, R[:, :, 2])
    sides = np.array([-0.5, 0.5]) * body.tread
    return ((speed[:, None] + yaw_rate[:, None] * sides) / body.wheel_radius - pitch_rate[:, None]).ravel()


@dataclass(frozen=True, eq=False)
class _Shift:
    """Abstract state; read-only, so that Drake may share it."""

    number: int
    progress: float
    joints: np.ndarray
    wheels: np.ndarray
    shape: BodyShape | None = field(default=None)

    def __deepcopy__(self, memo: dict) -> "_Shift":
        return self


class ShiftControl(LeafSystem):
    """
    .. pydrake_system::

        name: ShiftControl
        input_ports:
        - path
        - speed_command
        - wheel_speeds
        output_ports:
        - joint_command
        - wheel_speed_command
        - progress

    Moves the body of a snake with n units along a path like a train: every unit does where it is what the one in front
    of it did there (shift control, row S1-c). See `fit_shape` for how the body is fitted to the path.

    - `path` (`BodyPath`): the line for the axles. Another number begins anew at its start; `NO_PATH` holds the body.
    - `speed_command` (1) [m/s]: along the path, negative backwards; not finite counts as zero. At the ends of the path
      it stops.
    - `wheel_speeds` (2n) [rad/s], optional: measured, for `progress: measured`.
    - `joint_command` (2n - 1) [rad], p0, y0, p1, ..., within the ranges of the joints; NaN without a path.
    - `wheel_speed_command` (2n) [rad/s], left and right of unit 0, of unit 1, ....
    - `progress` (1) [m] since the path's start.

    With `progress: measured` the shape waits for a body that is stuck, with `commanded` it pushes on. Raises
    `ConfigError` on values out of range and `PortError` when `path` or a needed input is missing.
    """

    def __init__(self, config: ShiftControlConfig, *, body: SnakeBody):
        super().__init__()
        check_config(config, key="shift_control")
        self._config, self._body = config, body
        joints, wheels = 2 * body.units - 1, 2 * body.units
        self.DeclareAbstractInputPort("path", AbstractValue.Make(NO_PATH))
        self.DeclareVectorInputPort("speed_command", 1)
        self.DeclareVectorInputPort("wheel_speeds", wheels)
        start = _Shift(NO_PATH.number, 0.0, np.full(joints, np.nan), np.zeros(wheels))
        state = self.abstract_state_ticket(self.DeclareAbstractState(AbstractValue.Make(start)))
        self.DeclarePeriodicUnrestrictedUpdateEvent(config.period, 0.0, self._Move)
        self.DeclareVectorOutputPort("joint_command", joints, self._CalcJointCommand, {state})
        self.DeclareVectorOutputPort("wheel_speed_command", wheels, self._CalcWheelSpeedCommand, {state})
        self.DeclareVectorOutputPort("progress", 1, self._CalcProgress, {state})

    @staticmethod
    def _shift(context: Context) -> _Shift:
        held: Any = context.get_abstract_state(0)
        return held.get_value()

    def _Move(self, context: Context, state: State) -> EventStatus:
        path = eval_typed(self, context, "path", BodyPath)
        shift, body, dt = self._shift(context), self._body, self._config.period
        if path.number == NO_PATH.number:
            shift = _Shift(path.number, 0.0, np.full_like(shift.joints, np.nan), np.zeros_like(shift.wheels))
        else:
            fresh = path.number != shift.number
            step = 0.0 if fresh else self._speed(context) * dt
            last = path.length - body.half_length - path.start
            progress = 0.0 if fresh else float(np.clip(shift.progress + step, min(0.0, -path.start), max(last, 0.0)))
            shape = fit_shape(path, path.start + progress, body.units, body.half_length)
            wheels = np.zeros_like(shift.wheels)
            if not fresh and shift.shape is not None:
                wheels = rolling_rates(shift.shape, shape, dt, body)
            if self._config.progress == "measured" and not fresh:
                wheels = self._push(context, wheels, progress - shift.progress)
            joints = np.clip(shape.angles, -body.joint_limits, body.joint_limits)
            shift = _Shift(path.number, progress, joints, wheels, shape)
        state.get_mutable_abstract_state(0).set_value(shift)
        return EventStatus.Succeeded()

    def _command(self, context: Context) -> float:
        speed = float(eval_typed(self, context, "speed_command", np.ndarray)[0])
        return float(np.clip(speed, -self._config.max_speed, self._config.max_speed)) if np.isfinite(speed) else 0.0

    def _speed(self, context: Context) -> float:
        """Speed [m/s] with which the shape goes on."""
        if self._config.progress == "commanded":
            return self._command(context)
        rates = eval_typed(self, context, "wheel_speeds", np.ndarray)
        rates = rates[np.isfinite(rates)]
        command = self._command(context)
        share = self._config.wheel_quantile if command >= 0 else 1.0 - self._config.wheel_quantile
        speed = self._body.wheel_radius * float(np.quantile(rates, share)) if len(rates) else 0.0
        return float(np.clip(speed, min(command, 0.0), max(command, 0.0)))

    def _push(self, context: Context, wheels: np.ndarray, moved: float) -> np.ndarray:
        """Wheels that go on pushing with the commanded speed when the shape moved less."""
        wanted = self._command(context)
        return wheels + (wanted - moved / self._config.period) / self._body.wheel_radius

    def _CalcJointCommand(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._shift(context).joints)

    def _CalcWheelSpeedCommand(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._shift(context).wheels)

    def _CalcProgress(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array([self._shift(context).progress]))
