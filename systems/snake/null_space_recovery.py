"""Frees the snake by moving a segment of its body while its head stands still (rows S1-a to S1-c)."""

from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, EventStatus, LeafSystem, State

from ..config import check_config
from ..ports import eval_typed, weak_method
from .null_space_config import NullSpaceConfig
from .recovery_motion import RecoveryCommand
from .recovery_run import start_run, step_run
from .recovery_state import RecoveryRun, RecoveryStatus, idle_run
from .snake_body import SnakeBody


class NullSpaceRecovery(LeafSystem):
    """
    .. pydrake_system::

        name: NullSpaceRecovery
        input_ports:
        - joint_angles
        - command
        - tip_margin
        - held_joint_command
        output_ports:
        - joint_command
        - wheel_speed_command
        - status
        - control_error
        - target_distance

    Moves a segment of the body away from where it is stuck. The segment is a redundant arm from a reference point, the
    pitch joint of its first unit, to a control point, that of its last; the control point moves up by one unit by way
    of the yaw joint between, the middle of the segment goes towards a target, and the body behind follows by shift
    control. In front of the reference point nothing moves: joints and wheels hold.

    θ̇ = J⁺{ẇ_ref - K(w_e - w_ref)} + (I - J⁺J) α η with η = ∂V/∂θ (S1-a) and V = a_t d² + a_s V_singular + a_j V_joint
    (S1-b). This is the θ̇ nearest to α η that moves the control point as wanted; with `bounded`, the nearest of those
    that keep all joints within their ranges and rates. `preset("paper")` is the law without bounds, damping and
    feedback.

    - `joint_angles` (2n - 1) [rad]: measured, p0, y0, p1, ... from the head.
    - `command` (`RecoveryCommand`): segment and target; another number starts or stops. A command that cannot be
      carried out is refused, and `status` says why: a segment outside the body or too short, a control point ahead of
      the reference, a target or an angle that is not finite.
    - `tip_margin` (1) [m], optional: distance of the centre of mass from the edge of the support polygon. The motion
      slows down below `slow_margin` and waits below `stop_margin`.
    - `held_joint_command` (2n - 1) [rad], optional: what the joints are commanded before it starts. The pitch joints
      go on from there and not from their measured angles, so that the body does not sink. The reference begins where
      the control point sagged to, and leaves the sag behind as the load of the drives goes that made it.
    - `joint_command` (2n - 1) [rad]: NaN before the first motion, then held at its end.
    - `wheel_speed_command` (2n) [rad/s]: left and right of unit 0, of unit 1, ...: wheels roll with the body.
    - `status` (`RecoveryStatus`): phase, and why it ended.
    - `control_error` (6): w_e - w_ref, position [m] and rotation vector [rad]. `target_distance` (1): d [m], NaN
      before the first motion.

    It starts where the joints are, also at a straight pose, which is singular, and beyond the ranges, to which it
    returns. It waits for a control point that lags behind. A target out of reach is approached as far as it goes.

    Raises `ConfigError` when a value of the configuration is out of range and `PortError` when an input is missing.
    """

    def __init__(self, config: NullSpaceConfig, *, body: SnakeBody):
        super().__init__()
        check_config(config, key="null_space")
        self._config, self._body = config, body
        joints = 2 * body.units - 1
        self.DeclareVectorInputPort("joint_angles", joints)
        self.DeclareAbstractInputPort("command", AbstractValue.Make(RecoveryCommand()))
        self._tip_margin = self.DeclareVectorInputPort("tip_margin", 1)
        self._held = self.DeclareVectorInputPort("held_joint_command", joints)
        state = self.abstract_state_ticket(self.DeclareAbstractState(AbstractValue.Make(idle_run(body))))
        self.DeclarePeriodicUnrestrictedUpdateEvent(config.period, 0.0, self._Tick)
        self.DeclareVectorOutputPort("joint_command", joints, self._CalcJointCommand, {state})
        self.DeclareVectorOutputPort("wheel_speed_command", 2 * body.units, self._CalcWheelSpeedCommand, {state})
        self.DeclareAbstractOutputPort(
            "status", lambda: AbstractValue.Make(RecoveryStatus()), weak_method(self._CalcStatus), {state}
        )
        self.DeclareVectorOutputPort("control_error", 6, self._CalcControlError, {state})
        self.DeclareVectorOutputPort("target_distance", 1, self._CalcTargetDistance, {state})

    @staticmethod
    def _run(context: Context) -> RecoveryRun:
        held: Any = context.get_abstract_state(0)
        return held.get_value()

    def _Tick(self, context: Context, state: State) -> EventStatus:
        run = self._run(context)
        command = eval_typed(self, context, "command", RecoveryCommand)
        angles = np.array(eval_typed(self, context, "joint_angles", np.ndarray))
        if command.number != run.command.number:
            held = None
            if self._held.HasValue(context):
                held = np.array(eval_typed(self, context, "held_joint_command", np.ndarray))
            run = start_run(run, command, angles, self._body, self._config, held)
        margin = np.inf
        if self._tip_margin.HasValue(context):
            margin = float(eval_typed(self, context, "tip_margin", np.ndarray)[0])
        run = step_run(run, angles, margin, self._body, self._config)
        state.get_mutable_abstract_state(0).set_value(run)
        return EventStatus.Succeeded()

    def _CalcJointCommand(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._run(context).joints)

    def _CalcWheelSpeedCommand(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.repeat(self._run(context).wheels, 2))

    def _CalcStatus(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._run(context).status)

    def _CalcControlError(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._run(context).status.control_error)

    def _CalcTargetDistance(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array([self._run(context).status.distance]))
