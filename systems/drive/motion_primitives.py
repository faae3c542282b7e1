"""The four motions that routes are learnt with, driven: one cell ahead or back, 45° to the left or right (row S0-h)."""

from dataclasses import dataclass, replace

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from ..config import check_config, quantity
from ..errors import InputError
from ..ports import eval_typed, weak_method
from ..tracking import planar_pose, pose_error

FORWARD, BACK, LEFT, RIGHT = range(4)
PRIMITIVES = ("forward", "back", "left", "right")
IDLE, TURN, DRIVE, SETTLE, DONE, FAILED = range(6)
STATUS = ("idle", "running", "running", "running", "done", "failed")
_HEADING = np.pi / 4


@dataclass(kw_only=True)
class MotionPrimitivesConfig:
    """How far and how fast the motions go."""

    # [m] Way ahead and back along the edges of the grid: one cell. Along its diagonals it is √2 times as long.
    step: float = quantity(0.5, unit="m", above=0)
    # Motions end at one of the eight headings of the map, so that errors of the heading do not add up. False: ahead
    # and turn are seen from the heading at the start, and every step has the same length, as in the paper.
    on_grid: bool = True
    # [m/s], [rad/s] Fastest, and slowest towards the end: below it skidding tracks stand still.
    speed: float = quantity(0.3, unit="m/s", above=0)
    yaw_rate: float = quantity(0.8, unit="rad/s", above=0)
    min_speed: float = quantity(0.04, unit="m/s", above=0)
    min_yaw_rate: float = quantity(0.15, unit="rad/s", above=0)
    # [m/s²], [rad/s²] Decelerations towards the end.
    deceleration: float = quantity(0.3, unit="m/s²", above=0)
    yaw_deceleration: float = quantity(1.5, unit="rad/s²", above=0)
    # [1/s], [1/m²] Gains of keeping to the line of a step: on the heading, and on the way off it (Kanayama's K_y).
    heading_gain: float = quantity(1.5, unit="1/s", low=0)
    line_gain: float = quantity(4.0, unit="1/m²", low=0)
    # [m], [rad] What may be missing at the end. [rad] A step begins with a turn when the heading is off by more.
    tolerance: float = quantity(0.005, unit="m", above=0)
    turn_tolerance: float = quantity(0.02, unit="rad", above=0)
    turn_above: float = quantity(0.1, unit="rad", above=0)
    # [s] The robot stands this long before a motion is done, so that the belts have come to rest.
    settle: float = quantity(0.1, unit="s", low=0)
    # [-] A motion has failed when it takes this many times as long as at full speed, and [s] this much more.
    patience: float = quantity(2.5, low=1)
    grace: float = quantity(2.0, unit="s", low=0)
    # [s] Period of the control.
    period: float = quantity(0.02, unit="s", above=0)


@dataclass(frozen=True)
class Motion:
    """A motion that is under way, or the last one.

    Attributes:
        phase: index into `STATUS`. action: index into `PRIMITIVES`, -1 before the first.
        x, y: where it began [m]. heading: that it is to end with [rad].
        length: along `heading`, negative backwards [m]; 0 for a turn.
        since: when it began [s]. mark: when it came to rest [s]. limit: when it has failed [s].
    """

    phase: int = IDLE
    action: int = -1
    x: float = 0.0
    y: float = 0.0
    heading: float = 0.0
    length: float = 0.0
    since: float = 0.0
    mark: float = 0.0
    limit: float = 0.0

    def to_state(self) -> np.ndarray:
        numbers = (self.x, self.y, self.heading, self.length, self.since, self.mark, self.limit)
        return np.array([self.phase, self.action, *numbers])

    @staticmethod
    def from_state(state: np.ndarray) -> "Motion":
        return Motion(int(state[0]), int(state[1]), *(float(value) for value in state[2:]))


def begin_motion(action: int, pose: np.ndarray, now: float, config: MotionPrimitivesConfig) -> Motion:
    """The motion `action` (index into `PRIMITIVES`) from a pose (3,) x, y, heading [m, m, rad] at time `now` [s].

    Raises:
        InputError: there is no such motion.
    """
    if action not in range(len(PRIMITIVES)):
        raise InputError("not a motion", where="begin_motion", value=action, valid=f"0 to 3, {', '.join(PRIMITIVES)}")
    x, y, heading = (float(value) for value in pose)
    turns = {LEFT: 1, RIGHT: -1}.get(action, 0)
    length = {FORWARD: config.step, BACK: -config.step}.get(action, 0.0)
    target = heading + turns * _HEADING
    if config.on_grid:
        number = round(heading / _HEADING) + turns
        target, length = number * _HEADING, length * (np.sqrt(2.0) if number % 2 else 1.0)
    angle = abs(target - heading) if turns or abs(target - heading) > config.turn_above else 0.0
    shortest = abs(length) / config.speed + angle / config.yaw_rate
    limit = now + config.patience * shortest + config.grace
    return Motion(TURN if angle else DRIVE, action, x, y, target, length, now, now, limit)


def progress(motion: Motion, pose: np.ndarray) -> tuple[float, float, float]:
    """What remains along the line [m], the way to the left off it [m], and the turn that remains, in (-π, π] [rad]."""
    x_e, y_e, _ = pose_error(np.array([motion.x, motion.y, motion.heading]), np.array(pose, float))
    turn = pose_error(np.array(pose, float), np.array([motion.x, motion.y, motion.heading]))[2]
    return motion.length - float(x_e), float(y_e), float(turn)


def next_motion(motion: Motion, pose: np.ndarray, now: float, config: MotionPrimitivesConfig) -> Motion:
    """The motion after one more look at the pose; the same object when nothing changes."""
    if motion.phase not in (TURN, DRIVE, SETTLE):
        return motion
    remaining, _, turn = progress(motion, pose)
    if motion.phase == SETTLE:
        return replace(motion, phase=DONE, mark=now) if now - motion.mark >= config.settle - 1e-9 else motion
    if now > motion.limit:
        return replace(motion, phase=FAILED, mark=now)
    if motion.phase == TURN and abs(turn) <= config.turn_tolerance:
        return replace(motion, phase=DRIVE if motion.length else SETTLE, mark=now)
    if motion.phase == DRIVE and remaining * np.sign(motion.length) <= config.tolerance:
        return replace(motion, phase=SETTLE, mark=now)
    return motion


def motion_twist(motion: Motion, pose: np.ndarray, config: MotionPrimitivesConfig) -> np.ndarray:
    """(2,) v [m/s], omega [rad/s]: as fast as allowed and as still lets it stop at the end; zero when not under way."""
    remaining, left, turn = progress(motion, pose)
    if motion.phase == TURN:
        fastest = np.sqrt(2 * config.yaw_deceleration * abs(turn))
        slowest = min(config.min_yaw_rate, config.yaw_rate)
        return np.array([0.0, np.copysign(np.clip(fastest, slowest, config.yaw_rate), turn)])
    if motion.phase == DRIVE:
        fastest = np.sqrt(2 * config.deceleration * abs(remaining))
        v = np.copysign(np.clip(fastest, min(config.min_speed, config.speed), config.speed), motion.length)
        omega = config.heading_gain * turn - v * config.line_gain * left
        return np.array([v, np.clip(omega, -config.yaw_rate, config.yaw_rate)])
    return np.zeros(2)


class MotionPrimitives(LeafSystem):
    """
    .. pydrake_system::

        name: MotionPrimitives
        input_ports:
        - action
        - X_MB
        output_ports:
        - twist_command
        - status
        - motion

    Drives the four motions of `PRIMITIVES` one after the other, so that a policy can be executed as a table that is
    looked up (row S0-h). Every motion is closed on the pose: it ends when the pose says that it is made.

    - `action` (1): index into `PRIMITIVES` of the next motion; anything else means: none. It is looked at only between
      two motions, every `period`; a motion that has begun is carried through.
    - `X_MB` (RigidTransform): base B in the map M by odometry or SLAM.
    - `twist_command` (2): v [m/s], omega [rad/s]; zero between motions.
    - `status` (str): "idle", "running", "done" for one period after a motion, or "failed" for one after a motion that
      took too long: the robot is held up.
    - `motion` (1): index of the motion that is under way or was the last, -1 before the first.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PortError: an input is not connected or of another type.
    """

    def __init__(self, config: MotionPrimitivesConfig | None = None):
        super().__init__()
        self._config = config or MotionPrimitivesConfig()
        check_config(self._config, key="motion_primitives")
        self.DeclareVectorInputPort("action", 1)
        pose = self.DeclareAbstractInputPort("X_MB", AbstractValue.Make(RigidTransform()))
        state = self.DeclareDiscreteState(Motion().to_state())
        self._state, ticket = int(state), self.discrete_state_ticket(state)
        self.DeclarePeriodicDiscreteUpdateEvent(self._config.period, 0.0, self._Update)
        self.DeclareVectorOutputPort("twist_command", 2, self._CalcTwist, {ticket, pose.ticket()})
        self.DeclareAbstractOutputPort("status", lambda: Value[str](), weak_method(self._CalcStatus), {ticket})
        self.DeclareVectorOutputPort("motion", 1, self._CalcMotion, {ticket})

    def _motion(self, context: Context) -> Motion:
        return Motion.from_state(context.get_discrete_state(self._state).value())

    def _pose(self, context: Context) -> np.ndarray:
        return planar_pose(eval_typed(self, context, "X_MB", RigidTransform))

    def _Update(self, context: Context, discrete_state: DiscreteValues) -> None:
        motion, pose, now = self._motion(context), self._pose(context), context.get_time()
        if motion.phase in (IDLE, DONE, FAILED):
            action = float(eval_typed(self, context, "action", np.ndarray)[0])
            motion = replace(motion, phase=IDLE)
            if action in range(len(PRIMITIVES)):
                motion = begin_motion(int(action), pose, now, self._config)
        else:
            motion = next_motion(motion, pose, now, self._config)
        discrete_state.set_value(self._state, motion.to_state())

    def _CalcTwist(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(motion_twist(self._motion(context), self._pose(context), self._config))

    def _CalcStatus(self, context: Context, output: AbstractValue) -> None:
        output.set_value(STATUS[self._motion(context).phase])

    def _CalcMotion(self, context: Context, output: BasicVector) -> None:
        output[0] = self._motion(context).action
