"""Which direction of the histogram to take, and whether there is room to turn or to back up (row S3-c)."""

import math

import numpy as np

from .histogram import RiskHistogram
from .vfh_state import Sight, VfhConfig

# [m] Over which remembered ground is asked about the beginning of a direction.
_VETO = (0.15, 0.7)
# [m] An obstacle's cell within so much of the robot's edge may be one that it only touches.
_RIM = 0.1
# [m] Deeper than this by a turn is farther in: less is the noise of poses.
_DEEPER = 0.02
# [m] Places to turn are tried so far apart.
_BACK_STEP = 0.1


def wrapped(angle: float) -> float:
    """The angle in (-pi, pi] [rad]."""
    return float(np.arctan2(np.sin(angle), np.cos(angle)))


def nearest_to_goal(histogram: RiskHistogram, goal_H: np.ndarray) -> int | None:
    """The paper's choice: of the passable rectangles the one whose far edge's midpoint is nearest to the goal.

    Args:
        goal_H: (2,) [m], in the heading frame.
    """
    if not histogram.passable.any():
        return None
    distance = np.hypot(*(histogram.far_edges - goal_H).T)
    return int(np.argmin(np.where(histogram.passable, distance, np.inf)))


def best_direction(sight: Sight, wanted: float, aim: float, config: VfhConfig) -> int | None:
    """Of the passable rectangles, that in the direction nearest to the `wanted`, with inertia.

    Where the beginning of a direction is blocked over remembered ground, it is left out: a rectangle may be narrower
    than the robot.

    Args:
        wanted: direction in the heading frame [rad]. aim: direction in M that was driven in so far [rad], or NaN.
    """
    histogram = sight.histogram
    away = _angle_between(histogram.directions, wanted)
    if np.isfinite(aim):
        away = away + config.inertia * _angle_between(histogram.directions, aim - sight.pose[2])
    for k in np.argsort(away, kind="stable"):
        if histogram.passable[k] and open_ahead(sight, float(histogram.directions[k])):
            return int(k)
    return None


def open_ahead(sight: Sight, direction: float) -> bool:
    """Whether remembered ground leaves the beginning of a direction (in the heading frame, [rad]) open.

    It always does where the robot is too near to an obstacle already: it must get away."""
    if sight.field is None:
        return True
    heading = direction + sight.pose[2]
    ahead = np.array([np.cos(heading), np.sin(heading)])
    start, end = (sight.pose[:2] + length * ahead for length in _VETO)
    too_near = not np.isfinite(sight.field.line(sight.pose[:2], start)[0])
    return too_near or bool(np.isfinite(sight.field.line(start, end)[0]))


def turn_depth(
    obstacles: np.ndarray, footprint: list[float], turn: float, slide: tuple[float, float] = (0.0, 0.0)
) -> float:
    """How far into an obstacle a rectangle, length × width around the origin, gets while it turns by `turn` [rad], [m];
    0 or less where it has room.

    Args:
        obstacles: (n, 2) [m], in the rectangle's frame. One that is less than `_RIM` inside it may not get farther in;
            what is farther in does not count: the robot stands on that already.
        slide: (2,) [m/rad], downhill: how far the rectangle slides while it turns and is aligned with it. It slides
            along its axis, by the part of this that is along it.
    """
    depth = _depth(obstacles, footprint)
    rest, depth = obstacles[depth <= _RIM], depth[depth <= _RIM]
    # At a corner 3 cm an angle, below the size of a cell.
    step = 0.06 / math.hypot(*footprint)
    angles = np.linspace(0, turn, 2 + int(abs(turn) / step))[:, None]
    c, s = np.cos(angles), np.sin(angles)
    along = (c * slide[0] + s * slide[1]) * abs(turn) / (len(angles) - 1)
    gone = np.cumsum(np.vstack([np.zeros((1, 2)), (along * np.hstack([c, s]))[:-1]]), axis=0)
    x, y = rest[:, 0] - gone[:, :1], rest[:, 1] - gone[:, 1:]
    then = _depth(np.stack([c * x + s * y, c * y - s * x], axis=-1), footprint)
    return float(np.max(then - np.where(depth > 0, depth + _DEEPER, 0), initial=-np.inf))


def place_to_turn(
    obstacles: np.ndarray, footprint: list[float], turn: float, slide: tuple[float, float], farthest: float
) -> float:
    """How far to back up [m], at most `farthest`, to where a turn has room, else to where it gets least deep into an
    obstacle; see `turn_depth`. The strip behind is free as far as that."""
    best, place = np.inf, 0.0
    for back in np.arange(0, farthest + 1e-9, _BACK_STEP):
        if back > 0 and not room_behind(obstacles, footprint, back):
            break
        depth = turn_depth(obstacles + np.array([back, 0.0]), footprint, turn, slide)
        if depth < best - _DEEPER:
            best, place = depth, float(back)
        if depth <= 0:
            break
    return place


def room_behind(obstacles: np.ndarray, footprint: list[float], distance: float = 0.15) -> bool:
    """Whether the strip of `distance` [m] behind the rectangle is free of obstacles (n, 2) in its frame.

    What is farther in than `_RIM` does not count: the robot stands on that already, and may hang there."""
    x, y = obstacles.T
    behind = (x < min(_RIM - 0.5 * footprint[0], 0)) & (x > -0.5 * footprint[0] - distance)
    return not ((np.abs(y) < 0.5 * footprint[1]) & behind).any()


def nearness(obstacles: np.ndarray, direction: float, footprint: list[float], beside: float) -> float:
    """How near the robot is to what stands ahead or beside it, as it looks in `direction` [rad]: 1 at it, 0 from
    `beside` [m] on, (1 − gap/beside)² between.

    Args:
        obstacles: (n, 2) [m], in the robot's heading frame; what is behind its middle does not count.
    """
    if not len(obstacles):
        return 0.0
    c, s = math.cos(direction), math.sin(direction)
    along, across = obstacles @ [c, s], obstacles @ [-s, c]
    gaps = np.hypot(np.maximum(along - 0.5 * footprint[0], 0), np.maximum(np.abs(across) - 0.5 * footprint[1], 0))
    gap = float(np.min(gaps, where=along > 0, initial=np.inf))
    return max(1 - gap / beside, 0.0) ** 2


def _angle_between(directions: np.ndarray, angle: float) -> np.ndarray:
    return np.abs(np.remainder(directions - angle + np.pi, 2 * np.pi) - np.pi)


def _depth(points: np.ndarray, footprint: list[float]) -> np.ndarray:
    """How far in a rectangle points (..., 2) are [m], negative outside."""
    return (0.5 * np.array(footprint) - np.abs(points)).min(axis=-1)
