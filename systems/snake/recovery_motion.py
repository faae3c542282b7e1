"""What a recovery does apart from the segment: the control point's way and the trailing body (row S1-c)."""

import itertools
from dataclasses import dataclass

import numpy as np

from ..errors import ConfigError
from .body_path import BodyPath, fit_shape
from .chain import ChainKinematics

SMALLEST_SEGMENT = 4
"""Units. Three have five joints, fewer than the six components of the control point's pose."""

_STEPS = 100


@dataclass(frozen=True, eq=False)
class RecoveryCommand:
    """What an operator or a planner asks for.

    Attributes:
        number: of the command; another one starts anew. run: False stops what runs.
        first_unit, last_unit: ends of the segment, counted from the head; the pitch joint of the first is its
            reference point, that of the last its control point.
        target: (3,) for the middle joint of the segment, in the frame F0 of the head [m]. The head does not move.
        duration: of the motion [s]; that of the configuration when None.
    """

    number: int = 0
    run: bool = False
    first_unit: int = 0
    last_unit: int = 0
    target: tuple[float, float, float] = (0.0, 0.0, 0.0)
    duration: float | None = None

    @property
    def joints(self) -> slice:
        """Of the segment, among all of the body's."""
        return slice(2 * self.first_unit, 2 * self.last_unit + 1)

    def __deepcopy__(self, memo: dict) -> "RecoveryCommand":
        return self


@dataclass(frozen=True, eq=False)
class RecoveryMotion:
    """The control point's way from its place to the pitch joint in front of it, by way of the yaw joint between them.

    All in A: origin at the reference point, axes of the link in front of it. Tables are over the fraction of the way,
    S of them from 0 to 1.

    Attributes:
        position: (S, 3) of the control point [m]. rotation: (S, 3, 3) R_AC.
        twist: (S - 1, 6) (v, ω) between two places, for the whole way in unit time [m, rad].
        trailing: (S, r) angles of the joints behind the control point [rad].
        target: (3,) of the segment's middle joint [m].
        out_of_reach: by how much the middle joint cannot get to the target, at best [m].
    """

    position: np.ndarray
    rotation: np.ndarray
    twist: np.ndarray
    trailing: np.ndarray
    target: np.ndarray
    out_of_reach: float

    def __deepcopy__(self, memo: dict) -> "RecoveryMotion":
        return self

    def reference(self, fraction: float, fraction_rate: float) -> np.ndarray:
        """(18,) `reference` of `recovery_tick`: position, rotation row by row, twist, all in A."""
        i, f = self._place(fraction)
        twist = self.twist[i]
        position = self.position[i] + f * (self.position[i + 1] - self.position[i])
        rotation = rotation_by(f / (len(self.twist)) * twist[3:]) @ self.rotation[i]
        return np.concatenate([position, rotation.ravel(), fraction_rate * twist])

    def trailing_angles(self, fraction: float) -> np.ndarray:
        """(r,) angles behind the control point [rad]."""
        i, f = self._place(fraction)
        return self.trailing[i] + f * (self.trailing[i + 1] - self.trailing[i])

    def _place(self, fraction: float) -> tuple[int, float]:
        x = min(max(fraction, 0.0), 1.0) * len(self.twist)
        i = min(int(x), len(self.twist) - 1)
        return i, x - i

    def shortest_duration(self, max_speed: float, max_rate: float) -> float:
        """Time [s] in which a minimum-jerk motion keeps to these speeds [m/s, rad/s]."""
        speed = np.linalg.norm(self.twist[:, :3], axis=1).max(initial=0.0)
        rate = np.abs(np.diff(self.trailing, axis=0)).max(initial=0.0) * len(self.twist)
        return 1.875 * max(speed / max_speed, rate / max_rate)


def plan_motion(
    angles: np.ndarray, command: RecoveryCommand, half_length: float, *, shift: bool = True
) -> RecoveryMotion:
    """The motion that `command` asks for, of a body with joint `angles` (2n - 1,) [rad].

    With `shift` the trailing body stays on the line on which it lies, moved up by one unit (row S1-c); otherwise its
    joints hold their angles.

    Raises:
        ConfigError: the segment or the target is not usable; says what would be.
    """
    check_command(angles, command)
    first, last = command.first_unit, command.last_unit
    chain = ChainKinematics(len(angles) - 2 * first, half_length)
    origins, _, _ = chain.joint_frames(angles[2 * first :])
    end = 2 * (last - first)
    R_last = ChainKinematics(end + 1, half_length).control_pose(angles[2 * first : 2 * last + 1])[0]
    R_next = ChainKinematics(end - 1, half_length).control_pose(angles[2 * first : 2 * last - 1])[0]
    turn = rotation_vector(R_next @ R_last.T)
    fractions = np.linspace(0.0, 1.0, _STEPS + 1)
    rotation = np.array([rotation_by(f * turn) @ R_last for f in fractions])
    behind = angles[2 * last + 1 :]
    trailing = np.tile(behind, (_STEPS + 1, 1))

    R_tail = ChainKinematics(chain.joints, half_length).control_pose(angles[2 * first :])[0]
    tail = origins[-1] - half_length * R_tail[:, 0]
    line = BodyPath(np.vstack([tail, origins[: end - 3 : -1]]), 0.0)
    start = line.length - 2 * half_length
    position = np.array([line.at(start + f * 2 * half_length) for f in fractions])
    if shift:
        units = (len(angles) + 1) // 2 - last
        for i, f in enumerate(fractions):
            # The fit may turn the first link about its axle: that is the attitude that does not disturb the body.
            shape = fit_shape(line, start + f * 2 * half_length, units, half_length, attitude=rotation[i])
            rotation[i] = rotation[i] @ rotation_by(np.array([0.0, shape.angles[0], 0.0]))
            trailing[i] = shape.angles[1:]
    turns = np.array([rotation_vector(b @ a.T) for a, b in itertools.pairwise(rotation)])
    twist = np.hstack([np.diff(position, axis=0), turns]) * _STEPS

    X = head_in_segment(angles, first, half_length)
    target = X[0] @ np.asarray(command.target, dtype=float) + X[1]
    middle = (end + 1 - 1) // 2
    reaches = (
        np.linalg.norm(target) - middle * half_length,
        np.linalg.norm(target - position[-1]) - (end - middle) * half_length,
    )
    return RecoveryMotion(position, rotation, twist, trailing, target, max(0.0, *reaches))


def check_command(angles: np.ndarray, command: RecoveryCommand) -> None:
    """Raises `ConfigError` when a segment or a target is not usable, or an angle is not a number."""
    units = (len(angles) + 1) // 2
    first, last = command.first_unit, command.last_unit
    if not (0 <= first < units and 0 <= last < units):
        raise ConfigError(
            "the segment is outside the body", key="segment", value=(first, last), valid=f"0 to {units - 1}"
        )
    if last <= first:
        problem = "the control point is not behind the reference point"
        raise ConfigError(problem, key="segment", value=(first, last), valid="last_unit > first_unit")
    if last - first + 1 < SMALLEST_SEGMENT:
        problem = "the segment is too short to hold the pose of its control point"
        raise ConfigError(problem, key="segment", value=(first, last), valid=f">= {SMALLEST_SEGMENT} units")
    if not np.isfinite(command.target).all():
        raise ConfigError("the target is not finite", key="target", value=command.target, valid="x, y, z in F0 [m]")
    if command.duration is not None and not (np.isfinite(command.duration) and command.duration > 0):
        raise ConfigError("out of range", key="duration", value=command.duration, valid="> 0 s")
    if not np.isfinite(angles).all():
        j = int(np.flatnonzero(~np.isfinite(angles))[0])
        raise ConfigError("joint has no angle", key=joint_name(j), value=float(angles[j]))


def joint_name(index: int) -> str:
    """p0, y0, p1, ... of the joint with this index from the head."""
    return f"{'py'[index % 2]}{index // 2}"


def head_in_segment(angles: np.ndarray, first_unit: int, half_length: float) -> tuple[np.ndarray, np.ndarray]:
    """R_AH (3, 3) and p_AH (3,) [m] of the head frame F0 in the frame A of a segment that begins with `first_unit`."""
    if first_unit == 0:
        return np.eye(3), np.array([half_length, 0.0, 0.0])
    chain = ChainKinematics(2 * first_unit, half_length)
    origins, _, R = chain.joint_frames(angles[: 2 * first_unit])
    p_HA = np.array([-half_length, 0.0, 0.0]) + origins[-1] - half_length * R[:, 0]
    return R.T, -R.T @ p_HA


def middle_in_head(angles: np.ndarray, first_unit: int, last_unit: int, half_length: float) -> np.ndarray:
    """Where the middle joint of a segment is, in F0 (3,) [m]: what a target is meant for."""
    joints = first_unit + last_unit + 1  # up to and with the middle one
    origins = ChainKinematics(joints, half_length).positions(angles[:joints])
    return origins[-1] + [-half_length, 0.0, 0.0]


def rotation_by(vector: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) by a rotation vector (3,) [rad]."""
    angle = float(np.sqrt(vector @ vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K)


def rotation_vector(R: np.ndarray) -> np.ndarray:
    """Rotation vector (3,) [rad] of a rotation by less than half a turn."""
    v = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    s = float(np.sqrt(v @ v))
    return v if s < 1e-9 else v * (np.arctan2(s, 0.5 * (np.trace(R) - 1.0)) / s)


def minimum_jerk(u: float) -> tuple[float, float]:
    """Fraction of the way at the fraction `u` of the time, and its derivative; at rest outside 0 to 1."""
    u = min(max(u, 0.0), 1.0)
    return u**3 * (10 - 15 * u + 6 * u * u), 30 * u * u * (1 - u) ** 2
