"""Who drives: nobody, the robot itself or the operator, and what happens when the operator's link is lost (S0-k)."""

import math
from dataclasses import dataclass

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from ..config import check_config, quantity
from ..ports import eval_typed, weak_method

STOP, AUTONOMOUS, TELEOPERATION = MODES = ("stop", "autonomous", "teleoperation")


@dataclass(kw_only=True)
class ModeSwitchConfig:
    """When the operator's input is too old, and how fast the robot may go in any mode."""

    # [s] Tele-operation input older than this stops the robot: some two periods of a slow link.
    link_timeout: float = quantity(0.5, unit="s", above=0)
    # [s] A stamp may lie this far ahead of our clock.
    clock_tolerance: float = quantity(0.1, unit="s", low=0)
    # [m/s], [rad/s] Fastest twist that is passed on.
    max_speed: float = quantity(0.3, unit="m/s", above=0)
    max_yaw_rate: float = quantity(0.8, unit="rad/s", above=0)


@dataclass(frozen=True)
class Decision:
    """What drives the robot now.

    Attributes:
        mode: one of `MODES`, in force now.
        reason: why it is not the mode that was asked for, "" when it is.
        twist: v [m/s] and omega [rad/s].
    """

    mode: str
    reason: str
    twist: tuple[float, float]


def decide(
    command: str,
    autonomous_twist: np.ndarray,
    teleoperation_twist: np.ndarray,
    input_age: float,
    config: ModeSwitchConfig,
) -> Decision:
    """Decides who drives. Whatever is not in order stops the robot; nothing raises.

    Args:
        command: one of `MODES`.
        autonomous_twist, teleoperation_twist: (2,) v [m/s], omega [rad/s].
        input_age: how long ago the operator's input was made [s]; negative when its stamp lies ahead of our clock.
    """

    def stop(reason: str) -> Decision:
        return Decision(STOP, reason, (0.0, 0.0))

    if command == STOP:
        return stop("")
    if command not in MODES:
        return stop(f"unknown mode {command!r}, valid: {', '.join(MODES)}")
    if command == TELEOPERATION:
        if not math.isfinite(input_age):
            return stop("no tele-operation input yet")
        if input_age > config.link_timeout:
            return stop(f"tele-operation input lost for {input_age:.2f} s")
        if input_age < -config.clock_tolerance:
            return stop(f"tele-operation stamp {-input_age:.2f} s ahead of the clock")
    v, omega = (float(x) for x in (teleoperation_twist if command == TELEOPERATION else autonomous_twist))
    if not (math.isfinite(v) and math.isfinite(omega)):
        return stop(f"{command} twist is not finite")
    scale = max(1.0, abs(v) / config.max_speed, abs(omega) / config.max_yaw_rate)
    return Decision(command, "", (v / scale, omega / scale))


class ModeSwitch(LeafSystem):
    """
    .. pydrake_system::

        name: ModeSwitch
        input_ports:
        - mode_command
        - autonomous_twist
        - teleoperation_twist
        - teleoperation_time
        output_ports:
        - twist_command
        - mode
        - reason

    Switches between stop, autonomous driving and tele-operation (row S0-k). It has no state, so that a command counts
    from the instant at which it is there, between two updates of everything else too.

    - `mode_command` (str): what is asked for, one of `MODES`; anything else stops the robot.
    - `autonomous_twist` (2), `teleoperation_twist` (2): v [m/s], omega [rad/s]; the one in force must be finite, or the
      robot stops. Only that one is evaluated.
    - `teleoperation_time` (1): stamp of the operator's newest input [s, the simulation's clock], NaN or infinite when
      there was none. In tele-operation the robot stops when the stamp is older than `link_timeout`, and goes on when
      input comes again. Autonomous driving needs no link: the robot works where radio does not reach.
    - `twist_command` (2): the twist in force, scaled down to the limits with its curvature kept.
    - `mode` (str): the mode in force; `reason` (str): why it is not the one asked for, "" when it is.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PortError: an input that is needed is not connected or of another type.
    """

    def __init__(self, config: ModeSwitchConfig | None = None):
        super().__init__()
        self._config = config or ModeSwitchConfig()
        check_config(self._config, key="mode_switch")
        self.DeclareAbstractInputPort("mode_command", Value[str]())
        self.DeclareVectorInputPort("autonomous_twist", 2)
        self.DeclareVectorInputPort("teleoperation_twist", 2)
        self.DeclareVectorInputPort("teleoperation_time", 1)
        self.DeclareVectorOutputPort("twist_command", 2, self._CalcTwist)
        self.DeclareAbstractOutputPort("mode", lambda: Value[str](), weak_method(self._CalcMode))
        self.DeclareAbstractOutputPort("reason", lambda: Value[str](), weak_method(self._CalcReason))

    def _decide(self, context: Context) -> Decision:
        command = eval_typed(self, context, "mode_command", str)
        twists, age = {AUTONOMOUS: np.zeros(2), TELEOPERATION: np.zeros(2)}, 0.0
        if command in twists:
            twists[command] = eval_typed(self, context, f"{command}_twist", np.ndarray)
        if command == TELEOPERATION:
            age = context.get_time() - float(eval_typed(self, context, "teleoperation_time", np.ndarray)[0])
        return decide(command, twists[AUTONOMOUS], twists[TELEOPERATION], age, self._config)

    def _CalcTwist(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array(self._decide(context).twist))

    def _CalcMode(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._decide(context).mode)

    def _CalcReason(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._decide(context).reason)
