"""Worlds in which a snake is stuck: the five classes of row S1-d, each drawn from a seed, and how the snake lies there.

The source names five classes by what touches and by what would help, and describes 1 and 5 in words (its figure is
not to be had). They are read here as follows; the obstacle never moves.

1. Geometric, wheels from below: a plate stands on the floor between two axles; the next wheels run into its face.
2. By friction, wheels from the side: a bend of the body is wedged between two walls, the sides of its wheels rub.
3. Geometric, wheels from the side: two posts reach in between the wheels; the next wheels run into their faces.
4. By friction, belly on top of something: a round stone carries the body, the wheels carry too little.
5. By friction, belly on an edge: while it climbs a step, the underside of the body rests on the step's edge.

Geometric means that no thrust helps; by friction means that the robot is free when the friction is zero. Frame W: z up,
floor at z = 0, the robot ahead along x, the place where it is stuck near x = 0.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from naraha.systems.errors import WorldError
from pydrake.math import RigidTransform, RollPitchYaw

from ..snake.snake_model import SnakeModel
from . import surfaces
from .world import Solid, World

KINDS = (1, 2, 3, 4, 5)
# Classes that no thrust can free.
GEOMETRIC = (1, 3)


@dataclass(frozen=True, eq=False, kw_only=True)
class StuckCase:
    """A world and a snake in it.

    Attributes:
        kind: class 1 to 5.
        stuck: False for a world of the same kind in which the snake is not stuck.
        unit: where it is stuck: the unit, counted from the head, whose wheels or belly the obstacle holds.
        X_WB: pose of the head link at the start.
        joint_angles: (2n - 1,) at the start, from head to tail [rad].
        joint_command: (2n - 1,) what the joints hold; where the body is wedged, more than they reach [rad].
        place: (3,) point on the obstacle that holds the robot, in W [m].
    """

    kind: int
    stuck: bool
    world: World
    unit: int
    X_WB: RigidTransform
    joint_angles: np.ndarray
    joint_command: np.ndarray
    place: np.ndarray = field(default_factory=lambda: np.zeros(3))


def stuck_case(
    kind: int, seed: int = 0, *, stuck: bool = True, friction: float | None = None, snake: SnakeModel | None = None
) -> StuckCase:
    """Draws a case of class `kind`.

    Args:
        stuck: False draws one that looks alike and in which the snake drives on.
        friction: of the obstacle, instead of the one that is drawn.

    Raises:
        WorldError: there is no such class, or the snake is too short.
    """
    if kind not in KINDS:
        raise WorldError("unknown class of stuck state", key="kind", value=kind, valid=list(KINDS))
    snake = SnakeModel() if snake is None else snake
    if snake.units < 8:
        raise WorldError("the snake is too short for these worlds", key="units", value=snake.units, valid=">= 8")
    rng = np.random.default_rng([seed, kind])
    unit = int(rng.integers(3, snake.units - 4, endpoint=True))
    make = {1: _plate, 2: _passage, 3: _posts, 4: _stone, 5: _step}[kind]
    return make(rng, unit, stuck, friction, snake)


def build(kind: int) -> Callable[[int], World]:
    """The builder of the worlds of one class, for `naraha.models.worlds.BUILDERS`."""
    return lambda seed: stuck_case(kind, seed).world


def _straight(snake: SnakeModel, unit: int, x: float, z: float) -> RigidTransform:
    """Pose of the head link of a straight snake whose axle `unit` is at `x`."""
    return RigidTransform(np.array([x + snake.half_length * (1 + 2 * unit), 0.0, z]))


def _world(solids: list[Solid]) -> World:
    floor = Solid(name="floor", box=[8, 4, 0.2], xyz=[0, 0, -0.1], surface="floor", rgb=[0.5, 0.5, 0.48], friction=0.8)
    return World(
        solids=[floor, *solids],
        surfaces={"floor": surfaces.CONCRETE_FLOOR, "wall": surfaces.CONCRETE_WALL, "debris": surfaces.RUBBLE},
    )


def _obstacle(name: str, box: list[float], xyz: list[float], friction: float, surface: str = "debris") -> Solid:
    look: dict[str, Any] = {"rgb": [0.72, 0.52, 0.3], "surface": surface, "friction": float(friction)}
    return Solid(name=name, box=[float(v) for v in box], xyz=[float(v) for v in xyz], **look)


def _plate(rng: np.random.Generator, unit: int, stuck: bool, friction: float | None, s: SnakeModel) -> StuckCase:
    clearance = s.wheel_radius - s.belly_depth
    height = clearance - rng.uniform(0.002, 0.006) if stuck else rng.uniform(0.003, 0.006)
    thickness, gap = rng.uniform(0.010, 0.016), rng.uniform(0.0, 0.004)
    mu = rng.uniform(0.05, 0.15) if friction is None else friction
    # The rear face touches the wheel's rim where the rim is as high as the plate.
    reach = np.sqrt(s.wheel_radius**2 - (s.wheel_radius - height) ** 2)
    plate = _obstacle("plate", [thickness, 0.6, height], [0, 0, height / 2], mu)
    X_WB = _straight(s, unit, -reach - gap - thickness / 2, s.wheel_radius)
    still = np.zeros(2 * s.units - 1)
    return StuckCase(
        kind=1,
        stuck=stuck,
        world=_world([plate]),
        unit=unit,
        X_WB=X_WB,
        joint_angles=still,
        joint_command=still,
        place=np.array([0.0, 0.0, height]),
    )


def _passage(rng: np.random.Generator, unit: int, stuck: bool, friction: float | None, s: SnakeModel) -> StuckCase:
    angle, side = np.deg2rad(rng.uniform(21, 28)), rng.choice([-1.0, 1.0])
    drawn = rng.uniform(0.5, 0.9)
    mu = drawn if friction is None else friction
    offset = 2 * s.half_length * np.sin(angle)  # of the bent-out unit, in free air
    squeeze = rng.uniform(0.03, 0.045) if stuck else -rng.uniform(0.02, 0.05)
    width = s.tread + s.wheel_width + offset - squeeze
    command = np.zeros(2 * s.units - 1)
    # Yaw joints follow units unit-2 to unit+1: the unit itself points ahead, but stands out to one side.
    for i, sign in zip(range(unit - 2, unit + 2), (1, -1, -1, 1), strict=True):
        command[2 * i + 1] = side * sign * angle
    walls = [
        _obstacle(name, [5, 0.1, 0.15], [0, y * (width / 2 + 0.05), 0.075], mu, "wall")
        for name, y in (("wall_left", 1), ("wall_right", -1))
    ]
    return StuckCase(
        kind=2,
        stuck=stuck,
        world=_world(walls),
        unit=unit,
        X_WB=_straight(s, unit, 0.0, s.wheel_radius),
        joint_angles=np.zeros_like(command),
        joint_command=command,
        place=np.array([0.0, -side * width / 2, s.wheel_radius]),
    )


def _posts(rng: np.random.Generator, unit: int, stuck: bool, friction: float | None, s: SnakeModel) -> StuckCase:
    inner = s.half_width + rng.uniform(0.004, 0.008)  # within the wheels, beside the body
    if not stuck:
        inner = s.tread / 2 + s.wheel_width / 2 + rng.uniform(0.008, 0.03)
    thickness, height, reach = rng.uniform(0.012, 0.02), rng.uniform(0.07, 0.09), rng.uniform(0.08, 0.25)
    gap = rng.uniform(0.0, 0.004)
    mu = rng.uniform(0.05, 0.15) if friction is None else friction
    posts = [
        _obstacle(name, [thickness, reach, height], [0, y * (inner + reach / 2), height / 2], mu)
        for name, y in (("post_left", 1), ("post_right", -1))
    ]
    still = np.zeros(2 * s.units - 1)
    return StuckCase(
        kind=3,
        stuck=stuck,
        world=_world(posts),
        unit=unit,
        X_WB=_straight(s, unit, -s.wheel_radius - gap - thickness / 2, s.wheel_radius),
        joint_angles=still,
        joint_command=still,
        place=np.array([0.0, 0.0, height]),
    )


def _stone(rng: np.random.Generator, unit: int, stuck: bool, friction: float | None, s: SnakeModel) -> StuckCase:
    # Higher, and the joints give way around the stone: then its own shape holds the robot, without any friction.
    rise = rng.uniform(0.006, 0.0095) if stuck else -rng.uniform(0.006, 0.015)
    radius, width = rng.uniform(0.06, 0.1), rng.uniform(0.09, 0.12)
    drawn, along = rng.uniform(0.8, 1.2), rng.uniform(-0.06, 0.06)
    # Right above the stone a pitch joint gives way on both sides of it, and again the shape holds.
    along = float(np.copysign(max(abs(along), 0.012), along))
    return _on_stone(rise, radius, width, along, drawn if friction is None else friction, unit, stuck, s)


def _on_stone(
    rise: float, radius: float, width: float, along: float, mu: float, unit: int, stuck: bool, s: SnakeModel
) -> StuckCase:
    """A straight snake over a half-buried round stone [m].

    Args:
        rise: of the stone's top over the belly's clearance. along: of the pitch joint of `unit` past the top.
    """
    height = s.wheel_radius - s.belly_depth + rise
    look: dict[str, Any] = {"rgb": [0.72, 0.52, 0.3], "surface": "debris", "friction": float(mu)}
    lying: dict[str, Any] = {"xyz": [0.0, 0.0, float(height - radius)], "rpy_deg": [90.0, 0.0, 0.0]}
    stone = Solid(name="stone", cylinder=[float(radius), float(width)], **lying, **look)
    still = np.zeros(2 * s.units - 1)
    return StuckCase(
        kind=4,
        stuck=stuck,
        world=_world([stone]),
        unit=unit,
        X_WB=_straight(s, unit, along, s.wheel_radius + max(0.0, rise)),
        joint_angles=still,
        joint_command=still,
        place=np.array([0.0, 0.0, height]),
    )


def _step(rng: np.random.Generator, unit: int, stuck: bool, friction: float | None, s: SnakeModel) -> StuckCase:
    height, lip, slope = rng.uniform(0.09, 0.13), rng.uniform(0.025, 0.032), np.deg2rad(rng.uniform(12, 18))
    pressed = rng.uniform(0.003, 0.005) if stuck else -rng.uniform(0.01, 0.02)
    mu = rng.uniform(0.8, 1.2) if friction is None else friction
    return _on_step(height, lip, slope, pressed, mu, unit - 1, stuck, s)


def _on_step(
    height: float, lip: float, slope: float, pressed: float, mu: float, unit: int, stuck: bool, s: SnakeModel
) -> StuckCase:
    """A snake on its way up a step [m, rad]: `unit` and those before it are on top, the next hangs.

    Args:
        lip: how far the edge stands up between the wheels. On a plain edge the belly lies only where the body goes up
            by 26 degrees or more, and there gravity alone holds the robot, without any friction.
        slope: of the body behind `unit`.
        pressed: by how much the belly would be below the edge, if it could.
    """
    angles, X_WB = lie_on_step(height, lip, slope, s.belly_depth - pressed, unit, s)
    step = _obstacle("step", [3, 2, height], [1.5, 0, height / 2], 0.8)
    look: dict[str, Any] = {"rgb": [0.4, 0.4, 0.42], "surface": "debris", "friction": float(mu)}
    radius, width = 0.01, s.tread - 2 * s.wheel_width
    lying: dict[str, Any] = {"xyz": [radius, 0.0, float(height + lip - radius)], "rpy_deg": [90.0, 0.0, 0.0]}
    edge = Solid(name="edge", cylinder=[radius, width], **lying, **look)
    foot = _obstacle("edge_foot", [2 * radius, width, lip], [radius, 0, height + lip / 2 - radius], mu)
    return StuckCase(
        kind=5,
        stuck=stuck,
        world=_world([step, edge, foot]),
        unit=unit,
        X_WB=X_WB,
        joint_angles=angles,
        joint_command=angles,
        place=np.array([0.0, 0.0, height + lip]),
    )


def lie_on_step(
    height: float, lip: float, slope: float, over: float, unit: int, s: SnakeModel
) -> tuple[np.ndarray, RigidTransform]:
    """Joint angles of a snake on a step whose edge is at x = 0, and the pose of its head.

    The axles up to `unit` are on top. From there the body goes down with `slope` [rad], its joint axes `over` [m] above
    the top of the edge's `lip`, to the next axle, and from that one on down to the floor.
    """
    length, radius = 2 * s.half_length, s.wheel_radius
    ahead = ((radius - lip) * np.cos(slope) - over) / np.sin(slope)  # of the axle of `unit` past the edge
    axles = [np.array([ahead + length * i, height + radius]) for i in range(unit, -1, -1)]
    axles.append(axles[-1] - length * np.array([np.cos(slope), np.sin(slope)]))
    while len(axles) < s.units:
        down = min(1.0, (axles[-1][1] - radius) / length)
        axles.append(axles[-1] - length * np.array([np.sqrt(1 - down**2), down]))
    way = -np.diff(axles, axis=0)
    climb = np.arctan2(way[:, 1], way[:, 0])
    climb = np.r_[climb[0], climb, climb[-1]]
    angles = np.zeros(2 * s.units - 1)
    angles[::2] = climb[:-1] - climb[1:]
    nose = axles[0] + s.half_length * np.array([np.cos(climb[0]), np.sin(climb[0])])
    return angles, RigidTransform(RollPitchYaw(0, -climb[0], 0), np.array([nose[0], 0.0, nose[1]]))
