"""Follows a path: turn on the spot towards it, drive along it, slow in curves, stop at its end."""

import zlib
from dataclasses import dataclass, replace

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from ..config import check_config, quantity
from ..ports import eval_typed, weak_method
from .kanayama import planar_pose, pose_error
from .path import Path

IDLE, TURN, DRIVE, OFF, DONE = range(5)
STATUS = ("idle", "turning", "driving", "off the route", "arrived")


@dataclass(kw_only=True)
class PathFollowerConfig:
    """Speeds along a path, and when the robot turns on the spot, has arrived, or has left the path."""

    # [m/s] Speed on straight parts, and the slowest before the end: below it skidding tracks stand still.
    speed: float = quantity(0.3, unit="m/s", above=0)
    min_speed: float = quantity(0.05, unit="m/s", low=0)
    # [rad/s] Yaw rate that curves are driven at most with.
    curve_yaw_rate: float = quantity(0.4, unit="rad/s", above=0)
    # [m/s²] Deceleration towards curves and the end.
    deceleration: float = quantity(0.3, unit="m/s²", above=0)
    # [m] The path has been driven when this much of it remains.
    tolerance: float = quantity(0.05, unit="m", above=0)
    # [rad] Heading error from which on the robot stops and turns on the spot, and within which that ends.
    turn_above: float = quantity(0.7, unit="rad", above=0)
    turn_tolerance: float = quantity(0.08, unit="rad", above=0)
    # [1/s], [rad/s] Gain, largest and smallest yaw rate of turning on the spot.
    turn_gain: float = quantity(1.5, unit="1/s", above=0)
    turn_rate: float = quantity(0.8, unit="rad/s", above=0)
    min_turn_rate: float = quantity(0.15, unit="rad/s", low=0)
    # [m] Farther from the path the robot stops: it has been carried off, or the pose jumped.
    max_deviation: float = quantity(0.5, unit="m", above=0)
    # [m] How far ahead the nearest point is looked for: less than a loop of the path, more than a step of the robot.
    window: float = quantity(0.5, unit="m", above=0)
    # [s] Period of the decisions.
    period: float = quantity(0.05, unit="s", above=0)


@dataclass(frozen=True)
class Place:
    """Where the robot is on its path.

    Attributes:
        path: checksum of the path, 0 for none.
        phase: index into `STATUS`.
        s: how far it has come along the path [m].
    """

    path: int = 0
    phase: int = IDLE
    s: float = 0.0

    def to_state(self) -> np.ndarray:
        return np.array([self.path, self.phase, self.s])

    @staticmethod
    def from_state(state: np.ndarray) -> "Place":
        return Place(int(state[0]), int(state[1]), float(state[2]))


def checksum(path: Path) -> int:
    """Tells one path from another; 0 for the empty one."""
    return max(zlib.crc32(path.xy.tobytes()), 1) if len(path.xy) else 0


def next_place(place: Place, path: Path, pose: np.ndarray, config: PathFollowerConfig) -> Place:
    """Where the robot is after one more look at its pose (3,) x, y, heading [m, m, rad].

    A path that is new is entered at its nearest point, so a plan may be replaced in mid-leg. The same path goes on
    where it was left, at the nearest point within the window; a robot that has left the path waits until it is within
    half of `max_deviation` of any point of it, as after tele-operation.
    """
    if not len(path.xy):
        return Place()
    number, position = checksum(path), pose[:2]
    if number != place.path:
        s, distance = path.nearest(position)
        place = Place(number, TURN if distance <= config.max_deviation else OFF, s)
    elif place.phase == OFF:
        s, distance = path.nearest(position)
        if distance <= 0.5 * config.max_deviation:
            place = Place(number, TURN, s)
    elif place.phase in (TURN, DRIVE):
        s, distance = path.nearest(position, place.s - 0.5 * config.window, place.s + config.window)
        place = replace(place, s=s, phase=OFF if distance > config.max_deviation else place.phase)
    if place.phase in (TURN, DRIVE):
        if path.length_m - place.s <= config.tolerance:
            return replace(place, phase=DONE)
        error = abs(heading_error(place, path, pose))
        if place.phase == TURN and error < config.turn_tolerance:
            return replace(place, phase=DRIVE)
        if place.phase == DRIVE and error > config.turn_above:
            return replace(place, phase=TURN)
    return place


def heading_error(place: Place, path: Path, pose: np.ndarray) -> float:
    """From the robot's heading to that of the path beside it, in (-pi, pi] [rad]."""
    return float(pose_error(pose, path.at(place.s)[:3])[2])


def speed_at(path: Path, s: float, config: PathFollowerConfig) -> float:
    """Speed at arc length `s` [m/s]: so that every curve ahead and the end can be met with the deceleration."""
    arc, curvature = path.arc_length, np.abs(path.curvature)
    bend = abs(float(path.at(s)[3]))
    limit = np.minimum(config.speed, config.curve_yaw_rate / np.maximum(curvature, 1e-9))
    limit[-1] = 0.0
    ahead = arc >= s
    fastest = np.sqrt(limit[ahead] ** 2 + 2 * config.deceleration * (arc[ahead] - s)).min()
    here = min(config.speed, config.curve_yaw_rate / max(bend, 1e-9))
    return float(max(min(here, fastest), min(config.min_speed, config.speed)))


class PathFollower(LeafSystem):
    """
    .. pydrake_system::

        name: PathFollower
        input_ports:
        - route
        - X_MB
        output_ports:
        - reference_pose
        - reference_twist
        - progress
        - status

    Leads a robot at `X_MB` (RigidTransform, base B in map M) along `route` (`Path`, for example a `Route` of
    `naraha.systems.routes`; one without points means: stand still). Made to feed `KanayamaTracking`. The reference runs
    beside the robot on the path, so that slip delays it but never lets the reference run away. The robot turns on the
    spot at the start, wherever its heading is far off, and at corners that no curve leads round; it slows in curves,
    stops at the end, and stops when it is too far from the path. The route may be replaced at any time.

    - `reference_pose` (3): x, y, heading in M [m, m, rad]; `reference_twist` (2): v_r [m/s], omega_r [rad/s].
    - `progress` (1): share of the route's length that has been driven, in [0, 1].
    - `status` (str): one of `STATUS`.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PortError: an input is not connected or of another type.
    """

    def __init__(self, config: PathFollowerConfig | None = None):
        super().__init__()
        self._config = config or PathFollowerConfig()
        check_config(self._config, key="path_follower")
        self.DeclareAbstractInputPort("route", AbstractValue.Make(object()))
        self.DeclareAbstractInputPort("X_MB", AbstractValue.Make(RigidTransform()))
        self._state = int(self.DeclareDiscreteState(Place().to_state()))
        self.DeclarePeriodicDiscreteUpdateEvent(self._config.period, 0.0, self._Update)
        self.DeclareVectorOutputPort("reference_pose", 3, self._CalcReferencePose)
        self.DeclareVectorOutputPort("reference_twist", 2, self._CalcReferenceTwist)
        self.DeclareVectorOutputPort("progress", 1, self._CalcProgress)
        self.DeclareAbstractOutputPort("status", lambda: Value[str](), weak_method(self._CalcStatus))

    def _look(self, context: Context) -> tuple[Place, Path, np.ndarray]:
        """Where the robot is, as of the last decision; a route that came since then is not driven yet."""
        place = Place.from_state(context.get_discrete_state(self._state).value())
        path = eval_typed(self, context, "route", Path)
        pose = planar_pose(eval_typed(self, context, "X_MB", RigidTransform))
        return (place if checksum(path) == place.path else Place()), path, pose

    def _Update(self, context: Context, discrete_state: DiscreteValues) -> None:
        held = Place.from_state(context.get_discrete_state(self._state).value())
        _, path, pose = self._look(context)
        discrete_state.set_value(self._state, next_place(held, path, pose, self._config).to_state())

    def _beside(self, place: Place, path: Path, pose: np.ndarray) -> float:
        """Arc length of the path's point beside the robot now, between two decisions [m]."""
        window = self._config.window
        return path.nearest(pose[:2], place.s - 0.5 * window, place.s + window)[0]

    def _CalcReferencePose(self, context: Context, output: BasicVector) -> None:
        place, path, pose = self._look(context)
        if place.phase == DRIVE:
            output.SetFromVector(path.at(self._beside(place, path, pose))[:3])
        elif place.phase == TURN:
            output.SetFromVector(np.array([*pose[:2], path.at(place.s)[2]]))
        else:
            output.SetFromVector(pose)

    def _CalcReferenceTwist(self, context: Context, output: BasicVector) -> None:
        place, path, pose = self._look(context)
        config, v_r, omega_r = self._config, 0.0, 0.0
        if place.phase == DRIVE:
            s = self._beside(place, path, pose)
            v_r = speed_at(path, s, config)
            omega_r = float(np.clip(v_r * path.at(s)[3], -config.curve_yaw_rate, config.curve_yaw_rate))
        elif place.phase == TURN:
            turn = heading_error(place, path, pose)
            slowest = min(config.min_turn_rate, config.turn_rate)
            omega_r = float(np.copysign(np.clip(abs(config.turn_gain * turn), slowest, config.turn_rate), turn))
        output.SetFromVector(np.array([v_r, omega_r]))

    def _CalcProgress(self, context: Context, output: BasicVector) -> None:
        place, path, _ = self._look(context)
        output[0] = 1.0 if place.phase == DONE else place.s / path.length_m if path.length_m else 0.0

    def _CalcStatus(self, context: Context, output: AbstractValue) -> None:
        output.set_value(STATUS[self._look(context)[0].phase])
