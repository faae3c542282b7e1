"""A tour of waypoints: turn on the spot towards the next one, drive the straight leg, look around there, repeat."""

from dataclasses import dataclass, field, replace

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from ..config import check_config, quantity
from ..errors import ConfigError
from ..ports import eval_typed, weak_method
from .kanayama import planar_pose, pose_error

TURN, DRIVE, FACE, LOOK, DONE = range(5)


@dataclass(kw_only=True)
class Waypoint:
    """A point to reach, and how the flippers are held on the way to it."""

    # Position in the map frame M [m].
    xy: list[float] = quantity([0.0, 0.0], unit="m")
    # Flipper preset on the leg to this waypoint; "auto" leaves it to the pitch rule.
    flippers: str = "auto"
    # Headings in M to turn to there, one after the other, and to stand still at for `look_time` [deg].
    look_deg: list[float] = quantity([], unit="deg")


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
    # How long the robot stands still at each heading of `look_deg`, so that its sensors see their whole field [s].
    look_time: float = quantity(10.0, unit="s", low=0)
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


@dataclass(frozen=True)
class _Place:
    """Where the tour stands: the waypoint, what is done about it, and since when.

    Attributes:
        index: of the waypoint.
        phase: TURN towards it, DRIVE to it, FACE a heading there, LOOK around at that heading, or all is DONE.
        start: where the leg started (2) [m], NaN before the first step.
        look: which of the waypoint's headings.
        since: when LOOK began [s].
    """

    index: int
    phase: int
    start: np.ndarray
    look: int
    since: float

    def to_state(self) -> np.ndarray:
        return np.array([self.index, self.phase, *self.start, self.look, self.since])

    @staticmethod
    def from_state(state: np.ndarray) -> "_Place":
        return _Place(int(state[0]), int(state[1]), state[2:4].copy(), int(state[4]), float(state[5]))


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
    that slip delays the robot but never lets the reference run away. Where a waypoint has headings to look at, the
    robot turns to each and stands still there for a time. Made to feed `KanayamaTracking`.

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
        self.DeclareAbstractInputPort("X_MB", AbstractValue.Make(RigidTransform()))
        start = _Place(0, TURN, np.full(2, np.nan), 0, 0.0)
        self._state = int(self.DeclareDiscreteState(start.to_state()))
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

    def _place(self, context: Context) -> _Place:
        return _Place.from_state(context.get_discrete_state(self._state).value())

    def _Update(self, context: Context, discrete_state: DiscreteValues) -> None:
        place = self._place(context)
        if place.phase == DONE:
            return
        place = self._next(place, self._pose(context), context.get_time())
        discrete_state.set_value(self._state, place.to_state())

    def _next(self, place: _Place, pose: np.ndarray, time: float) -> _Place:
        """What to do after one more look at the pose."""
        config, waypoint = self._config, self._config.waypoints[place.index]
        if np.isnan(place.start).any():
            place = replace(place, start=pose[:2])
        if place.phase in (TURN, DRIVE):
            reference, remaining = leg_reference(pose, place.start, np.array(waypoint.xy))
            there = remaining <= config.tolerance
            if place.phase == TURN and (there or abs(pose_error(pose, reference)[2]) < config.turn_tolerance):
                return replace(place, phase=DRIVE, start=pose[:2])
            if place.phase == DRIVE and there:
                return self._look_or_leave(replace(place, look=0), pose)
        elif place.phase == FACE and abs(self._heading_error(place, pose)) < config.turn_tolerance:
            return replace(place, phase=LOOK, since=time)
        elif place.phase == LOOK and time - place.since >= config.look_time:
            return self._look_or_leave(replace(place, look=place.look + 1), pose)
        return place

    def _look_or_leave(self, place: _Place, pose: np.ndarray) -> _Place:
        if place.look < len(self._config.waypoints[place.index].look_deg):
            return replace(place, phase=FACE)
        index = place.index + 1
        phase = TURN if index < len(self._config.waypoints) else DONE
        return replace(place, index=index, phase=phase, start=pose[:2])

    def _heading(self, place: _Place, pose: np.ndarray) -> float:
        """The heading to turn to on the spot [rad]."""
        waypoint = self._config.waypoints[place.index]
        if place.phase == TURN:
            return float(np.arctan2(*(np.array(waypoint.xy) - pose[:2])[::-1]))
        return float(np.deg2rad(waypoint.look_deg[place.look]))

    def _heading_error(self, place: _Place, pose: np.ndarray) -> float:
        return float(pose_error(pose, np.array([*pose[:2], self._heading(place, pose)]))[2])

    def _CalcReferencePose(self, context: Context, output: BasicVector) -> None:
        pose, place = self._pose(context), self._place(context)
        if place.phase == DRIVE:
            pose, _ = leg_reference(pose, place.start, np.array(self._config.waypoints[place.index].xy))
        elif place.phase in (TURN, FACE):
            pose = np.array([*pose[:2], self._heading(place, pose)])
        output.SetFromVector(pose)

    def _CalcReferenceTwist(self, context: Context, output: BasicVector) -> None:
        pose, place, config = self._pose(context), self._place(context), self._config
        v_r, omega_r = 0.0, 0.0
        if place.phase == DRIVE:
            _, remaining = leg_reference(pose, place.start, np.array(config.waypoints[place.index].xy))
            v_r = min(config.speed, np.sqrt(2 * config.deceleration * remaining))
        elif place.phase in (TURN, FACE):
            turn = self._heading_error(place, pose)
            slowest = min(config.min_turn_rate, config.turn_rate)
            omega_r = float(np.copysign(np.clip(abs(config.turn_gain * turn), slowest, config.turn_rate), turn))
        output.SetFromVector(np.array([v_r, omega_r]))

    def _CalcFlipperPreset(self, context: Context, output: AbstractValue) -> None:
        place = self._place(context)
        output.set_value("auto" if place.phase == DONE else self._config.waypoints[place.index].flippers)

    def _CalcWaypointsReached(self, context: Context, output: BasicVector) -> None:
        output[0] = self._place(context).index

    def _CalcDone(self, context: Context, output: BasicVector) -> None:
        output[0] = float(self._place(context).phase == DONE)
