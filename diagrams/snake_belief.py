"""The surroundings that a stuck snake believes in: a world for rehearsals, from the diagnosis and what it measures."""

from dataclasses import dataclass

import numpy as np
from naraha.models.snake.snake_model import SnakeModel
from naraha.models.worlds import World, surfaces
from naraha.models.worlds.world import Solid
from naraha.systems.snake.posture import half_poses, nearest_by_half
from naraha.systems.snake.stuck_rules import Diagnosis
from pydrake.math import RigidTransform, RollPitchYaw

# Frictions that are assumed: of the ground, of what rubs, and of a face that only blocks.
GROUND, RUBBING, BLOCKING = 0.8, 0.9, 0.1
# Height that is assumed of what reaches in from the sides: that of a wheel's top.
POST_HEIGHT = 0.09


@dataclass(frozen=True, eq=False)
class Belief:
    """A world with a snake in it.

    Attributes:
        world: in a frame of its own: z up, the head's nose at x = y = 0, x along its heading.
        X_WB: pose of the head link. joint_angles: (2n - 1,) at the start [rad].
        joint_command: (2n - 1,) what the joints hold [rad].
    """

    world: World
    X_WB: RigidTransform
    joint_angles: np.ndarray
    joint_command: np.ndarray


def believe(
    diagnosis: Diagnosis,
    *,
    joint_angles: np.ndarray,
    joint_command: np.ndarray,
    rpy: np.ndarray,
    ranges: np.ndarray,
    snake: SnakeModel,
) -> Belief:
    """Builds the world in which the snake would be stuck as `diagnosis` says.

    Args:
        joint_angles: (2n - 1,) measured, joint_command: (2n - 1,) commanded; NaN counts as what is measured [rad].
        rpy: (3,) of the head. ranges: see `RangeSensors`.
    """
    poses = half_poses(joint_angles, rpy, snake.half_length)
    axles = np.array([X.translation() for X in poses[1::2]])
    # Stuck on a step, the last axle is on the floor; otherwise the lowest is.
    floor = axles[:, 2].min() - snake.wheel_radius
    X_WB = RigidTransform(poses[0].rotation(), np.array([0.0, 0.0, -floor]))
    axles[:, 2] -= floor
    make = {1: _plate, 2: _walls, 3: _posts, 4: _stone, 5: _step}.get(diagnosis.kind)
    solids = [] if make is None else make(diagnosis.unit, axles, poses, nearest_by_half(ranges, snake.units), snake)
    ground = Solid(name="floor", box=[12, 8, 0.2], xyz=[0, 0, -0.1], surface="floor", friction=GROUND)
    world = World(solids=[ground, *solids], surfaces={"floor": surfaces.CONCRETE_FLOOR, "thing": surfaces.RUBBLE})
    command = np.where(np.isfinite(joint_command), joint_command, joint_angles)
    return Belief(world, X_WB, np.array(joint_angles), command)


def _solid(name: str, box: list[float], place: np.ndarray, yaw: float, friction: float) -> Solid:
    lengths, xyz = [float(v) for v in box], [float(v) for v in place]
    turned = [0.0, 0.0, float(np.rad2deg(yaw))]
    return Solid(name=name, box=lengths, xyz=xyz, rpy_deg=turned, surface="thing", friction=friction)


def _yaw(poses: list[RigidTransform], unit: int) -> float:
    return float(RollPitchYaw(poses[2 * unit].rotation()).yaw_angle())


def _before(axle: np.ndarray, yaw: float, distance: float, sideways: float, height: float) -> np.ndarray:
    """A point `distance` ahead of an axle and `sideways` to its left, at `height` over the floor [m]."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([axle[0] + c * distance - s * sideways, axle[1] + s * distance + c * sideways, height])


def _plate(
    unit: int, axles: np.ndarray, poses: list[RigidTransform], nearest: np.ndarray, s: SnakeModel
) -> list[Solid]:
    clearance = s.wheel_radius - s.belly_depth
    height = clearance - min(max(float(nearest[:, 0].min()), 0.002), 0.5 * clearance)
    reach = np.sqrt(s.wheel_radius**2 - (s.wheel_radius - height) ** 2)
    yaw = _yaw(poses, unit)
    place = _before(axles[unit], yaw, reach + 0.007, 0.0, height / 2)
    return [_solid("plate", [0.012, 0.6, height], place, yaw, BLOCKING)]


def _posts(
    unit: int, axles: np.ndarray, poses: list[RigidTransform], nearest: np.ndarray, s: SnakeModel
) -> list[Solid]:
    inner = s.half_width + float(np.clip(nearest[:, 1:].max(axis=1).min(), 0.003, 0.012))
    yaw = _yaw(poses, unit)
    return [
        _solid(
            name,
            [0.014, 0.15, POST_HEIGHT],
            _before(axles[unit], yaw, s.wheel_radius + 0.009, sign * (inner + 0.075), POST_HEIGHT / 2),
            yaw,
            BLOCKING,
        )
        for name, sign in (("post_left", 1), ("post_right", -1))
    ]


def _walls(
    unit: int, axles: np.ndarray, poses: list[RigidTransform], nearest: np.ndarray, s: SnakeModel
) -> list[Solid]:
    along = axles[0, :2] - axles[-1, :2]
    yaw = float(np.arctan2(along[1], along[0]))
    left = np.array([-np.sin(yaw), np.cos(yaw)])
    outer = []
    for i, axle in enumerate(axles):
        turned = _yaw(poses, i) - yaw
        half = np.cos(turned) * s.tread / 2 + np.hypot(
            np.sin(turned) * s.wheel_radius, np.cos(turned) * s.wheel_width / 2
        )
        outer.append((axle[:2] @ left + half, axle[:2] @ left - half))
    high, low = max(o[0] for o in outer), min(o[1] for o in outer)
    middle = axles[:, :2].mean(axis=0)
    walls = []
    for name, face, sign in (("wall_left", high, 1), ("wall_right", low, -1)):
        place = middle + (face + sign * 0.05 - middle @ left) * left
        walls.append(_solid(name, [6.0, 0.1, 0.15], np.r_[place, 0.075], yaw, RUBBING))
    return walls


def _stone(
    unit: int, axles: np.ndarray, poses: list[RigidTransform], nearest: np.ndarray, s: SnakeModel
) -> list[Solid]:
    yaw, radius = _yaw(poses, unit), 0.08
    top = axles[unit, 2] - s.belly_depth + 0.002
    place = _before(axles[unit], yaw, 0.0, 0.0, top - radius)
    return [_cylinder("stone", radius, place, yaw)]


def _step(unit: int, axles: np.ndarray, poses: list[RigidTransform], nearest: np.ndarray, s: SnakeModel) -> list[Solid]:
    yaw = _yaw(poses, 0)
    behind = axles[min(unit + 1, s.units - 1)]
    way = axles[unit] - behind
    height = float(axles[: unit + 1, 2].min()) - s.wheel_radius
    # As far back as the wheels in front of the step allow, and under the middle of the body behind `unit` at most.
    back = min(0.45 * float(np.hypot(way[0], way[1])), float(np.hypot(way[0], way[1])) - s.wheel_radius - 0.02)
    edge = _before(axles[unit], yaw, -back, 0.0, 0.0)
    line = axles[unit, 2] - way[2] * back / max(float(np.hypot(way[0], way[1])), 1e-6)
    top = line - s.belly_depth + 0.002
    step = _solid("step", [4.0, 3.0, height], _before(edge, yaw, 2.0, 0.0, height / 2), yaw, GROUND)
    if top <= height + 0.002:
        return [step]
    return [step, _cylinder("edge", 0.01, _before(edge, yaw, 0.01, 0.0, top - 0.01), yaw)]


def _cylinder(name: str, radius: float, place: np.ndarray, yaw: float) -> Solid:
    lying = [90.0, 0.0, float(np.rad2deg(yaw))]
    xyz = [float(v) for v in place]
    return Solid(name=name, cylinder=[radius, 0.1], xyz=xyz, rpy_deg=lying, surface="thing", friction=RUBBING)
