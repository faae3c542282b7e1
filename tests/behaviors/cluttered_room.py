"""Random cluttered rooms and a round robot that moves in them as commanded, without physics."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from naraha.models import MODELS_DIR
from naraha.systems.behaviors import Behaviors, RuleBase, blend, braked, free_ways, goal_error, perceive, update_weights
from naraha.systems.behaviors.fuzzy_goal_seeking import GOAL_INPUTS
from naraha.systems.behaviors.fuzzy_obstacle_avoidance import AVOIDANCE_INPUTS

BEHAVIORS = MODELS_DIR / "lux_robot" / "behaviors.yaml"
ROBOT_RADIUS = 0.263
GAP = 0.9
"""Obstacles are at least this far from each other and from the walls [m]."""
ANGLES = np.deg2rad(np.arange(-135, 135.1, 0.5))
LASER_X = 0.12
"""The laser sits this far before the middle of the robot [m]."""


@dataclass(frozen=True)
class Room:
    """Walls around (0, 0) to `size`, polygons inside, start and goal."""

    size: np.ndarray
    polygons: list[np.ndarray]
    start: np.ndarray
    goal: np.ndarray

    @property
    def segments(self):
        """(S, 2, 2) from and to [m]."""
        x, y = self.size
        walls = np.array([[0, 0], [x, 0], [x, y], [0, y]], float)
        return np.concatenate([np.stack([p, np.roll(p, -1, axis=0)], axis=1) for p in [walls, *self.polygons]])


def distances(points, segments):
    """(N, S) distance of points to segments."""
    a, b = segments[:, 0], segments[:, 1]
    along = b - a
    t = np.einsum("nsk,sk->ns", points[:, None] - a, along) / np.einsum("sk,sk->s", along, along)
    return np.linalg.norm(points[:, None] - a - np.clip(t, 0, 1)[..., None] * along, axis=2)


def random_room(seed, obstacles=14, size=(10.0, 8.0)):
    """Boxes, turned at random, and columns of eight sides, as many of `obstacles` as fit; start and goal far apart."""
    rng = np.random.default_rng(seed)
    size = np.array(size)
    placed, polygons = [], []
    start = np.array([rng.uniform(0.5, 1.2), rng.uniform(0.5, size[1] - 0.5), rng.uniform(-np.pi, np.pi)])
    goal = np.array([rng.uniform(size[0] - 1.2, size[0] - 0.5), rng.uniform(0.5, size[1] - 0.5)])
    for _ in range(400):
        if len(polygons) == obstacles:
            break
        middle = rng.uniform(0, size)
        if rng.random() < 0.5:
            half, turn = rng.uniform(0.15, 0.9, 2), rng.uniform(0, np.pi)
            corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
            c, s = np.cos(turn), np.sin(turn)
            polygon = middle + corners @ np.array([[c, s], [-s, c]])
        else:
            around = np.arange(8) * np.pi / 4
            polygon = middle + rng.uniform(0.15, 0.6) * np.column_stack([np.cos(around), np.sin(around)])
        edge = polygon[:, None] + np.linspace(0, 1, 12)[:, None] * (np.roll(polygon, -1, axis=0) - polygon)[:, None]
        edge = edge.reshape(-1, 2)
        if (edge < GAP).any() or (edge > size - GAP).any():
            continue
        if any(np.linalg.norm(edge[:, None] - other, axis=2).min() < GAP for other in placed):
            continue
        near = min(np.linalg.norm(edge - p, axis=1).min() for p in (start[:2], goal))
        if near < 0.6 or inside(polygon, start[:2]) or inside(polygon, goal):
            continue
        placed.append(edge)
        polygons.append(polygon)
    return Room(size, polygons, start, goal)


def inside(polygon, point):
    edges = np.roll(polygon, -1, axis=0) - polygon
    side = edges[:, 0] * (point - polygon)[:, 1] - edges[:, 1] * (point - polygon)[:, 0]
    return bool((side > 0).all() or (side < 0).all())


def laser(segments, pose, rng=None, noise=0.01, reach=30.0):
    """Points in the robot's frame that a 2D laser of 270 degrees sees, (M, 2)."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    eye = pose[:2] + LASER_X * np.array([c, s])
    direction = np.column_stack([np.cos(ANGLES + pose[2]), np.sin(ANGLES + pose[2])])
    a, along = segments[:, 0] - eye, segments[:, 1] - segments[:, 0]
    cross = direction[:, :1] * along[:, 1] - direction[:, 1:] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        r = (a[:, 0] * along[:, 1] - a[:, 1] * along[:, 0]) / cross
        t = (a[:, 0] * direction[:, 1:] - a[:, 1] * direction[:, :1]) / cross
    r = np.where((t >= 0) & (t <= 1) & (r > 0), r, np.inf).min(axis=1)
    if rng is not None:
        r = r + rng.normal(0, noise, len(r))
    seen = r < reach
    return np.column_stack([LASER_X + r[seen] * np.cos(ANGLES[seen]), r[seen] * np.sin(ANGLES[seen])])


@dataclass(frozen=True)
class Drive:
    """How a drive ended."""

    arrived: bool
    clearance: float
    time: float
    path: np.ndarray


class Robot:
    """The behaviours of a file, by their numeric functions, in a robot that moves exactly as commanded."""

    def __init__(self, behaviors: Behaviors, where: Path | str = ""):
        self.behaviors = behaviors
        self.goal_rules = RuleBase(behaviors.goal_seeking, GOAL_INPUTS, 2, where=where)
        self.avoidance_rules = RuleBase(behaviors.obstacle_avoidance.rules, AVOIDANCE_INPUTS, 2, where=where)

    def drive(self, room: Room, *, seed=0, duration=120.0, tolerance=0.1, acceleration=1.0) -> Drive:
        """Drives to the goal; the speeds follow the commands within the acceleration of both wheels."""
        avoidance, coordinator = self.behaviors.obstacle_avoidance, self.behaviors.coordinator
        directions, rng, segments = avoidance.directions(), np.random.default_rng(seed), room.segments
        weights, pose, twist = np.array(coordinator.weights, float), room.start.copy(), np.zeros(2)
        clearance, period, path = np.inf, coordinator.period, [pose.copy()]
        for i in range(int(duration / period)):
            error = goal_error(pose, room.goal)
            if error[0] < tolerance:
                return Drive(True, clearance, i * period, np.array(path))
            points = laser(segments, pose, rng)
            ways = free_ways(points, directions, avoidance.radius, avoidance.reach)
            twists = np.array([self.goal_rules.infer(error), self.avoidance_rules.infer(np.append(ways, error[1]))])
            weights = update_weights(weights, perceive(ways, directions, error, coordinator), coordinator)
            v, omega = blend(weights, twists, coordinator)
            v = braked(v, omega, points, coordinator.radius, coordinator.deceleration, coordinator.delay)
            limit = acceleration * period * np.array([1.0, 4.0])
            for _ in range(5):
                twist = twist + np.clip(np.array([v, omega]) - twist, -limit / 5, limit / 5)
                pose = pose + period / 5 * np.array([twist[0] * np.cos(pose[2]), twist[0] * np.sin(pose[2]), twist[1]])
                clearance = min(clearance, float(distances(pose[None, :2], segments).min()) - ROBOT_RADIUS)
            path.append(pose.copy())
        return Drive(False, clearance, duration, np.array(path))
