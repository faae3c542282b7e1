"""Paths for the body of the snake, and the shape that follows them (row S1-c)."""

import itertools
from dataclasses import dataclass, field

import numpy as np

from ..errors import ConfigError
from .chain import ChainKinematics
from .path_kernels import fit_body, point_on


@dataclass(frozen=True, eq=False)
class BodyPath:
    """A line for the wheels' axles to run along, in a frame that does not move, z up.

    Attributes:
        points: (N, 3) [m] from where the tail comes from to where the head goes.
        start: arc length [m] at which the first axle stands when shift control begins.
        number: of the path; another one makes `ShiftControl` begin anew.
        lengths: (N,) arc lengths of the points [m].
    """

    points: np.ndarray
    start: float
    number: int = 0
    lengths: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        points = np.ascontiguousarray(self.points, dtype=float)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise ConfigError("not a list of points", key="points", value=points.shape, valid="(N, 3), finite")
        if not np.isfinite(self.start):
            raise ConfigError("not finite", key="start", value=self.start, valid="an arc length [m]")
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        keep = np.r_[True, steps > 1e-9]
        points, steps = points[keep], steps[keep[1:]]
        if len(points) < 2:
            raise ConfigError("a path needs two different points", key="points", value=len(points), valid=">= 2")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "lengths", np.r_[0.0, np.cumsum(steps)])

    def __deepcopy__(self, memo: dict) -> "BodyPath":
        return self

    @property
    def length(self) -> float:
        """Of the whole path [m]."""
        return float(self.lengths[-1])

    def at(self, s: float) -> np.ndarray:
        """The point (3,) at arc length `s` [m], straight on beyond the ends."""
        point = np.empty(3)
        point_on(self.points, self.lengths, float(s), point)
        return point


@dataclass(frozen=True, eq=False)
class BodyShape:
    """A body on a path.

    Attributes:
        angles: (2n - 1,) joint angles [rad].
        axles: (n, 3) where the axles are [m].
        frames: (n, 3, 3) attitudes of the links in front of the pitch joints.
    """

    angles: np.ndarray
    axles: np.ndarray
    frames: np.ndarray


def fit_shape(
    path: BodyPath, s: float, units: int, half_length: float, attitude: np.ndarray | None = None
) -> BodyShape:
    """The shape of `units` units whose first axle is at arc length `s` [m] of `path`; see `path_kernels.fit_body`.

    Args:
        attitude: (3, 3) of the link in front of the first axle; along the path with level axle when not given.
    """
    R = level_attitude(path, s, half_length) if attitude is None else np.array(attitude, dtype=float)
    angles, axles, frames = np.empty(2 * units - 1), np.empty((units, 3)), np.empty((units, 3, 3))
    fit_body(path.points, path.lengths, float(s), R, half_length, angles, axles, frames)
    return BodyShape(angles, axles, frames)


def level_attitude(path: BodyPath, s: float, half_length: float) -> np.ndarray:
    """Attitude (3, 3) of a link that ends at arc length `s` of the path: x along it, y level."""
    x = path.at(s + half_length) - path.at(s)
    x /= np.linalg.norm(x)
    y = np.cross([0.0, 0.0, 1.0], x)
    if np.linalg.norm(y) < 1e-6:  # straight up or down: any level axle will do
        y = np.array([0.0, 1.0, 0.0])
    y /= np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])


def path_of_body(angles: np.ndarray, half_length: float, ahead: np.ndarray | float, number: int = 0) -> BodyPath:
    """The path on which a body with joint `angles` (2n - 1,) stands, in the frame of its first link F0.

    Args:
        ahead: how it goes on before the nose: a length straight ahead [m], or points (N, 3) in F0 [m].
    """
    chain = ChainKinematics(len(angles), half_length)
    origins, _, R = chain.joint_frames(angles)
    offset = np.array([-half_length, 0.0, 0.0])
    tail = origins[-1] - half_length * R[:, 0]
    front = np.array([[float(ahead), 0.0, 0.0]]) if np.isscalar(ahead) else np.asarray(ahead, dtype=float)
    body = np.vstack([tail, origins[::-1]]) + offset
    return BodyPath(np.vstack([body, np.zeros((1, 3)), front]), len(angles) * half_length, number)


def path_over_ground(
    profile: np.ndarray, wheel_radius: float, *, edge_radius: float = 0.0, smoothing: float = 0.0
) -> np.ndarray:
    """Line (N, 3) [m] in the plane y = 0 that the axle of a wheel follows over a profile of the ground.

    Args:
        profile: (N, 2) corners x, z of the ground with x not falling; two with one x are a step.
        wheel_radius: [m].
        edge_radius: [m] distance that the line keeps from the corners; see `edge_radius` for a belly to clear them.
        smoothing: [m] width over which the line is rounded, never below where the wheel touches.
    """
    profile = np.asarray(profile, dtype=float)
    if profile.ndim != 2 or profile.shape[1] != 2 or len(profile) < 2 or not np.isfinite(profile).all():
        raise ConfigError("not a profile", key="profile", value=profile.shape, valid="(N, 2), finite")
    if (np.diff(profile[:, 0]) < 0).any():
        raise ConfigError("x must not fall", key="profile")
    x = np.arange(profile[0, 0], profile[-1, 0], wheel_radius / 25)
    ground_x = np.concatenate([np.linspace(a[0], b[0], 200) for a, b in itertools.pairwise(profile)])
    ground_z = np.concatenate([np.linspace(a[1], b[1], 200) for a, b in itertools.pairwise(profile)])
    gap = x[:, None] - ground_x
    reach = np.sqrt(np.maximum(wheel_radius**2 - gap**2, 0.0))
    z = np.max(np.where(np.abs(gap) <= wheel_radius, ground_z + reach, -np.inf), axis=1)
    for corner_x, corner_z in profile[1:-1]:
        near = np.abs(x - corner_x) <= edge_radius
        z[near] = np.maximum(z[near], corner_z + np.sqrt(edge_radius**2 - (x[near] - corner_x) ** 2))
    z = np.maximum(z, np.interp(x, profile[:, 0], profile[:, 1]) + wheel_radius)
    if smoothing > 0.0:
        half = max(1, round(0.5 * smoothing / (x[1] - x[0])))
        kernel = np.hanning(2 * half + 3)[1:-1]
        padded = np.concatenate([np.full(half, z[0]), z, np.full(half, z[-1])])
        highest = np.max(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1), axis=1)
        padded = np.concatenate([np.full(half, highest[0]), highest, np.full(half, highest[-1])])
        z = np.convolve(padded, kernel / kernel.sum(), mode="valid")
    return np.column_stack([x, np.zeros_like(x), z])


def edge_radius(half_length: float, belly_depth: float, clearance: float = 0.005) -> float:
    """How far axles must keep from an edge [m] for the straight belly between two of them to pass over it."""
    return float(np.hypot(half_length, belly_depth + clearance))
