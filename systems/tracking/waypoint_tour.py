"""A tour of waypoints: turn on the spot towards the next one, drive the straight leg, repeat."""

from dataclasses import dataclass, field

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from ..config import check_config, quantity
from ..errors import ConfigError
from ..ports import eval_typed, weak_method
from .kanayama import planar_pose, pose_error

TURN, DRIVE, DONE = 0.0, 1.0, 2.0


@dataclass(kw_only=True)
class Waypoint:
    """A point to reach, and how the flippers are held on the way to it."""

    # Position in the map frame M [m].
    xy: list[float] = quantity([0.0, 0.0], unit="m")
    # Flipper preset on the leg to this waypoint; "auto" leaves it to the pitch rule.
    flippers: str = "auto"


@dataclass(kw_only=True)
class TourConfig:
    """A list of waypoints and how it is driven."""

    waypoints: list[Waypoint] = field(default_factory=list)
    # Speed on the legs [m/s].
    speed: float = quantity(0.3, unit="m/s", above=0)
    # Deceleration towards a waypoint [m/s²].
    deceleration: float = quantity(0.3, unit="m/s²", above=0)
    # A waypoint counts as reached when this much of its leg remains [m].
    tolerance: float = quantity(0.1, unit="m", above=0)
    # Proportional gain of turning on the spot [1/s]; tracks turn slower than commanded, so it is high.
    turn_gain: float = quantity(1.5, unit="1/s", above=0)
    # Largest and smallest yaw rate of turning on the spot [rad/s]; below the smallest, skidding tracks stand still.
    turn_rate: float = quantity(0.8, unit="rad/s", above=0)
    min_turn_rate: float = quantity(0.15, unit="rad/s", low=0)
    # Turning ends within this heading error [rad].
    turn_tolerance: float = quantity(0.05, unit="rad", above=0)
    # Period of the decisions [s].
    period: float = quantity(0.05, unit="s", above=0)


def leg_reference(pose: np.ndarray, start: np.ndarray, goal: np.ndarray) -> tuple[np.ndarray, float]:
    """Returns the reference pose beside the robot on the leg from `start` to `goal`, and the way that remains [m].

    Args:
        pose: (3,) x, y, heading [m, m, rad]. start, goal: (2,) [m].

    Returns:
        (3,) foot of the perpendicular on the leg (not beyond its ends) and the leg's direction; the distance from the
        foot to the goal, 0 when the robot has passed it.
    """
    along = goal - start
    length = float(np.hypot(*along))
    if length < 1e-9:
        return np.array([*goal, pose[2]]), 0.0
    direction = along / length
    s = float(np.clip((pose[:2] - start) @ direction, 0.0, length))
    return np.array([*(start + s * direction), np.arctan2(direction[1], direction[0])]), length - s


class WaypointTour(LeafSystem):
    """
    .. pydrake_system::

        name: WaypointTour
        input_ports:
        - X_MB
        output_ports:
        - reference_pose
        - reference_twist
        - flipper_preset
        - waypoints_reached
        - done

    Leads a robot at `X_MB` (RigidTransform, base B in map M) along a list of waypoints. Each leg starts where the robot
    stands: first the heading is turned on the spot, then the reference runs beside the robot on the straight line, so
    that slip delays the robot but never lets the reference run away. Made to feed `KanayamaTracking`.

    - `reference_pose` (3): x, y, heading in M [m, m, rad]; `reference_twist` (2): v_r [m/s], omega_r [rad/s].
    - `flipper_preset` (str): the preset that the current waypoint asks for.
    - `waypoints_reached` (1), `done` (1): how many are reached; 1 after the last, when the twist is zero.

    Raises `ConfigError` for an empty list or a waypoint that is not two numbers.
    """

    def __init__(self, config: TourConfig):
        super().__init__()
        check_config(config, key="tour")
        if not config.waypoints:
            raise ConfigError("no waypoints", key="tour.waypoints", value=[], valid="at least one waypoint")
        for i, waypoint in enumerate(config.waypoints):
            if len(waypoint.xy) != 2:
                raise ConfigError("wrong length", key=f"tour.waypoints[{i}].xy", value=waypoint.xy, valid="two numbers")
        self._config = config
        self._goals = np.array([w.xy for w in config.waypoints])
        self.DeclareAbstractInputPort("X_MB", AbstractValue.Make(RigidTransform()))
        # Index of the waypoint, phase, and where the leg started (x, y).
        self._state = int(self.DeclareDiscreteState(np.array([0.0, TURN, np.nan, np.nan])))
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, 0.0, self._Update)
        self.DeclareVectorOutputPort("reference_pose", 3, self._CalcReferencePose)
        self.DeclareVectorOutputPort("reference_twist", 2, self._CalcReferenceTwist)
        by_state = {self.xd_ticket()}
        self.DeclareAbstractOutputPort(
            "flipper_preset", lambda: Value[str](), weak_method(self._CalcFlipperPreset), by_state
        )
        self.DeclareVectorOutputPort("waypoints_reached", 1, self._CalcWaypointsReached, by_state)
        self.DeclareVectorOutputPort("done", 1, self._CalcDone, by_state)

    def _pose(self, context: Context) -> np.ndarray:
        return planar_pose(eval_typed(self, context, "X_MB", RigidTransform))

    def _unpack(self, context: Context) -> tuple[int, float, np.ndarray, np.ndarray]:
        state = context.get_discrete_state(self._state).value()
        index = min(int(state[0]), len(self._goals) - 1)
        return index, state[1], state[2:], self._goals[index]

    def _Update(self, context: Context, discrete_state: DiscreteValues) -> None:
        index, phase, start, goal = self._unpack(context)
        if phase == DONE:
            return
        pose = self._pose(context)
        if np.isnan(start).any():
            start = pose[:2]
        reference, remaining = leg_reference(pose, start, goal)
        if phase == TURN and (
            remaining <= self._config.tolerance or abs(pose_error(pose, reference)[2]) < self._config.turn_tolerance
        ):
            phase, start = DRIVE, pose[:2]
        elif phase == DRIVE and remaining <= self._config.tolerance:
            index += 1
            phase, start = (TURN if index < len(self._goals) else DONE), pose[:2]
        discrete_state.set_value(self._state, np.array([index, phase, *start]))

    def _CalcReferencePose(self, context: Context, output: BasicVector) -> None:
        pose = self._pose(context)
        _, phase, start, goal = self._unpack(context)
        if phase == DRIVE:
            pose, _ = leg_reference(pose, start, goal)
        elif phase == TURN:
            pose = np.array([*pose[:2], np.arctan2(*(goal - pose[:2])[::-1])])
        output.SetFromVector(pose)

    def _CalcReferenceTwist(self, context: Context, output: BasicVector) -> None:
        pose = self._pose(context)
        _, phase, start, goal = self._unpack(context)
        v_r, omega_r = 0.0, 0.0
        if phase == DRIVE:
            _, remaining = leg_reference(pose, start, goal)
            v_r = min(self._config.speed, np.sqrt(2 * self._config.deceleration * remaining))
        elif phase == TURN:
            turn = pose_error(pose, np.array([*pose[:2], np.arctan2(*(goal - pose[:2])[::-1])]))[2]
            rate = np.clip(
                abs(self._config.turn_gain * turn),
                min(self._config.min_turn_rate, self._config.turn_rate),
                self._config.turn_rate,
            )
            omega_r = float(np.copysign(rate, turn))
        output.SetFromVector(np.array([v_r, omega_r]))

    def _CalcFlipperPreset(self, context: Context, output: AbstractValue) -> None:
        index, phase, _, _ = self._unpack(context)
        output.set_value("auto" if phase == DONE else self._config.waypoints[index].flippers)

    def _CalcWaypointsReached(self, context: Context, output: BasicVector) -> None:
        output[0] = context.get_discrete_state(self._state).value()[0]

    def _CalcDone(self, context: Context, output: BasicVector) -> None:
        output[0] = float(self._unpack(context)[1] == DONE)
