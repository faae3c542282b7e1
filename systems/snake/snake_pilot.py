"""Carries out one move of the snake at a time: what drives joints and wheels, and with how much torque."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, EventStatus, LeafSystem, State

from ..config import check_config, quantity
from ..errors import ConfigError
from ..ports import eval_typed, weak_method
from .body_path import BodyPath, path_of_body
from .recovery_motion import RecoveryCommand
from .shift_control import NO_PATH
from .snake_body import SnakeBody

# Kinds of move. hold: stand still. wheels: the wheels turn, the joints hold. shift: drive along the line on which the
# body lies, and straight on. relax: the joints are led to where they are for a moment, so that nothing presses.
# recover: null-space recovery.
MOVES = ("hold", "wheels", "shift", "relax", "recover")


@dataclass(frozen=True, kw_only=True)
class Move:
    """What the snake is to do until the next move.

    Attributes:
        number: another one begins a move. kind: one of `MOVES`.
        speed: of the wheels' rims or along the line, negative backwards [m/s].
        joints: (2n - 1,) angles to go to and hold, instead of those that are held [rad]; hold and wheels only.
        recovery: segment and target of a recovery; its number does not matter.
        wheel_torque: largest of a wheel [N m]; that of the pilot's configuration when None.
        label: in words, for people.
    """

    number: int = 0
    kind: str = "hold"
    speed: float = 0.0
    joints: tuple[float, ...] | None = None
    recovery: RecoveryCommand | None = None
    wheel_torque: float | None = None
    label: str = ""

    def __post_init__(self) -> None:
        if self.kind not in MOVES:
            raise ConfigError("unknown kind of move", key="move.kind", value=self.kind, valid=MOVES)
        if self.kind == "recover" and self.recovery is None:
            raise ConfigError("a recovery needs a segment and a target", key="move.recovery")
        if not np.isfinite(self.speed):
            raise ConfigError("not finite", key="move.speed", value=self.speed, valid="m/s")

    def __deepcopy__(self, memo: dict) -> "Move":
        return self


@dataclass(kw_only=True)
class SnakePilotConfig:
    """How moves are carried out."""

    # Time between two ticks.
    period: float = quantity(0.01, unit="s", above=0.0)
    # Largest torque of a wheel when the move does not say.
    wheel_torque: float = quantity(0.3, unit="N m", above=0.0)
    # How long relaxing takes.
    relax_time: float = quantity(1.0, unit="s", above=0.0)
    # How far the line goes on straight ahead of the nose.
    ahead: float = quantity(4.0, unit="m", above=0.0)


@dataclass(frozen=True, eq=False)
class _Pilot:
    """Abstract state; read-only, so that Drake may share it."""

    move: Move
    since: float
    joints: np.ndarray
    wheels: np.ndarray
    path: BodyPath
    torque: float
    recovery: RecoveryCommand

    def __deepcopy__(self, memo: dict) -> "_Pilot":
        return self


class SnakePilot(LeafSystem):
    """
    .. pydrake_system::

        name: SnakePilot
        input_ports:
        - move
        - joint_angles
        - shift_joint_command
        - shift_wheel_speed_command
        - recovery_joint_command
        - recovery_wheel_speed_command
        output_ports:
        - joint_command
        - wheel_speed_command
        - wheel_torque_limit
        - path
        - speed_command
        - recovery_command
        - mode

    Carries out one `move` (`Move`) after the other with a snake of n units; see `MOVES`.

    - `joint_angles` (2n - 1) [rad]: measured. The line of a shift is that on which they say the body lies.
    - `shift_joint_command`, `shift_wheel_speed_command`: of `ShiftControl`, which gets `path` (`BodyPath`) and
      `speed_command` (1) [m/s].
    - `recovery_joint_command`, `recovery_wheel_speed_command`: of `NullSpaceRecovery`, which gets `recovery_command`
      (`RecoveryCommand`).
    - `joint_command` (2n - 1) [rad], NaN where a joint is to hold its place; `wheel_speed_command` (2n) [rad/s] and
      `wheel_torque_limit` (2n) [N m].
    - `mode`: the kind of move, as it is shown to people.

    When a move begins, the joints hold what they were last commanded until the move says otherwise. Raises
    `ConfigError` on values out of range and `PortError` when a port is not connected or carries another type.
    """

    def __init__(self, config: SnakePilotConfig, *, body: SnakeBody):
        super().__init__()
        check_config(config, key="pilot")
        self._config, self._body = config, body
        joints, wheels = 2 * body.units - 1, 2 * body.units
        self.DeclareAbstractInputPort("move", AbstractValue.Make(Move()))
        self.DeclareVectorInputPort("joint_angles", joints)
        for source in ("shift", "recovery"):
            self.DeclareVectorInputPort(f"{source}_joint_command", joints)
            self.DeclareVectorInputPort(f"{source}_wheel_speed_command", wheels)
        start = _Pilot(
            Move(number=-1),
            0.0,
            np.full(joints, np.nan),
            np.zeros(wheels),
            NO_PATH,
            config.wheel_torque,
            RecoveryCommand(),
        )
        state = {self.abstract_state_ticket(self.DeclareAbstractState(AbstractValue.Make(start)))}
        self.DeclarePeriodicUnrestrictedUpdateEvent(config.period, 0.0, self._Tick)
        self.DeclareVectorOutputPort("joint_command", joints, self._CalcJointCommand, state)
        self.DeclareVectorOutputPort("wheel_speed_command", wheels, self._CalcWheelSpeedCommand, state)
        self.DeclareVectorOutputPort("wheel_torque_limit", wheels, self._CalcWheelTorqueLimit, state)
        self.DeclareAbstractOutputPort("path", lambda: AbstractValue.Make(NO_PATH), weak_method(self._CalcPath), state)
        self.DeclareVectorOutputPort("speed_command", 1, self._CalcSpeedCommand, state)
        self.DeclareAbstractOutputPort(
            "recovery_command",
            lambda: AbstractValue.Make(RecoveryCommand()),
            weak_method(self._CalcRecoveryCommand),
            state,
        )
        self.DeclareAbstractOutputPort("mode", lambda: AbstractValue.Make(""), weak_method(self._CalcMode), state)

    @staticmethod
    def _pilot(context: Context) -> _Pilot:
        held: Any = context.get_abstract_state(0)
        return held.get_value()

    def _Tick(self, context: Context, state: State) -> EventStatus:
        pilot = self._pilot(context)
        move = eval_typed(self, context, "move", Move)
        angles = np.array(eval_typed(self, context, "joint_angles", np.ndarray))
        if move.number != pilot.move.number:
            pilot = self._begin(pilot, move, angles, context.get_time())
        kind, elapsed = pilot.move.kind, context.get_time() - pilot.since
        rolling = pilot.move.speed / self._body.wheel_radius
        if kind in ("shift", "recover"):
            source = {"shift": "shift", "recover": "recovery"}[kind]
            joints = np.array(eval_typed(self, context, f"{source}_joint_command", np.ndarray))
            joints = np.where(np.isfinite(joints), joints, pilot.joints)
            wheels = np.array(eval_typed(self, context, f"{source}_wheel_speed_command", np.ndarray))
            if elapsed < 2.5 * self._config.period:  # its controller has not heard of the move yet
                joints, wheels = pilot.joints, np.zeros_like(wheels)
        elif kind == "relax":
            joints = np.where(np.isfinite(angles), angles, pilot.joints)
            joints = joints if elapsed < self._config.relax_time else pilot.joints
            wheels = np.zeros_like(pilot.wheels)
        else:
            joints = pilot.joints
            wheels = np.full_like(pilot.wheels, rolling if kind == "wheels" else 0.0)
        pilot = replace(pilot, joints=joints, wheels=wheels)
        state.get_mutable_abstract_state(0).set_value(pilot)
        return EventStatus.Succeeded()

    def _begin(self, pilot: _Pilot, move: Move, angles: np.ndarray, time: float) -> _Pilot:
        joints, path = pilot.joints, NO_PATH
        if move.joints is not None:
            joints = np.array(move.joints, float)
            if joints.shape != pilot.joints.shape:
                valid = f"{len(pilot.joints)} angles"
                raise ConfigError("wrong number of angles", key="move.joints", value=len(joints), valid=valid)
        recovery = RecoveryCommand(number=move.number)  # stops what runs
        if move.recovery is not None and move.kind == "recover":
            recovery = replace(move.recovery, number=move.number, run=True)
        if move.kind == "shift":
            path = path_of_body(np.nan_to_num(angles), self._body.half_length, self._config.ahead, move.number)
        torque = self._config.wheel_torque if move.wheel_torque is None else move.wheel_torque
        return _Pilot(move, time, joints, np.zeros_like(pilot.wheels), path, torque, recovery)

    def _CalcJointCommand(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._pilot(context).joints)

    def _CalcWheelSpeedCommand(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._pilot(context).wheels)

    def _CalcWheelTorqueLimit(self, context: Context, output: BasicVector) -> None:
        pilot = self._pilot(context)
        output.SetFromVector(np.full_like(pilot.wheels, pilot.torque))

    def _CalcPath(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._pilot(context).path)

    def _CalcSpeedCommand(self, context: Context, output: BasicVector) -> None:
        move = self._pilot(context).move
        output.SetFromVector(np.array([move.speed if move.kind == "shift" else 0.0]))

    def _CalcRecoveryCommand(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._pilot(context).recovery)

    def _CalcMode(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._pilot(context).move.kind)
