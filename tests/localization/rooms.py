"""Rooms of straight walls, and what a 2D laser sees in them, in closed form."""

import numpy as np
from naraha.systems.localization import LaserScan, odometry_step_covariance
from naraha.systems.localization.planar import compose

ANGLES = np.radians(np.linspace(-135, 135, 541))


def rectangle(x0, y0, x1, y1):
    """Four walls, (4, 2, 2)."""
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], float)
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def room():
    """8 × 6 m with a corner cut off, and a box of 1 × 0.8 m in it."""
    corners = np.array([[0, 0], [8, 0], [8, 6], [1, 6], [0, 4.5]], float)
    outside = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    return np.concatenate([outside, rectangle(5.5, 1.2, 6.5, 2.0)])


def corridor(length=60.0, width=3.0):
    """Two bare walls; the ends are 20 m farther out than the robot drives."""
    return rectangle(-20, -width / 2, length + 20, width / 2)


def cast(walls, X_WS, angles, range_max=30.0):
    """Distance along every beam to the nearest wall, (n,) [m], infinite beyond `range_max`."""
    heading = X_WS[2] + angles
    d = np.stack([np.cos(heading), np.sin(heading)], axis=1)[:, None]
    a, e = walls[None, :, 0] - X_WS[:2], walls[None, :, 1] - walls[None, :, 0]
    cross = d[..., 0] * e[..., 1] - d[..., 1] * e[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (a[..., 0] * e[..., 1] - a[..., 1] * e[..., 0]) / cross
        u = (a[..., 0] * d[..., 1] - a[..., 1] * d[..., 0]) / cross
    t = np.where((t > 0) & (u >= 0) & (u <= 1), t, np.inf).min(axis=1)
    return np.where(t < range_max, t, np.inf)


def scan_in(walls, X_WS, rng=None, *, noise=0.01, time=0.0, index=0, range_max=30.0, angles=ANGLES):
    ranges = cast(walls, X_WS, angles, range_max)
    if rng is not None:
        ranges = np.maximum(ranges + noise * rng.standard_normal(len(ranges)), 0.0)
    return LaserScan(ranges, angles, range_max, time, index=index)


def rasterised(walls, resolution=0.05, margin=1.0):
    """A plan of closed walls, (occupied (nx, ny) bool, origin (2,)): cells whose centre is not inside the room."""
    low, high = walls.min(axis=(0, 1)) - margin, walls.max(axis=(0, 1)) + margin
    shape = np.ceil((high - low) / resolution).astype(int)
    x, y = (low[k] + (np.arange(shape[k]) + 0.5) * resolution for k in range(2))
    inside = np.zeros(shape, bool)
    for (x0, y0), (x1, y1) in walls:
        if y0 != y1:  # how often a way to the far right crosses a wall
            crossed = (y > min(y0, y1)) & (y <= max(y0, y1))
            inside ^= crossed[None] & (x[:, None] < x0 + (y[None] - y0) * (x1 - x0) / (y1 - y0))
    return ~inside, low


def drive(start, steps):
    """Poses from `start` on by steps in the robot's axes, (n + 1, 3)."""
    poses = [np.asarray(start, float)]
    for step in steps:
        poses.append(compose(poses[-1], np.asarray(step, float)))
    return np.array(poses)


def noisy_odometry(steps, rng, accuracy):
    """The same way as odometry with random-walk errors of `accuracy` sees it, (n + 1, 3), from zero."""
    poses = [np.zeros(3)]
    for step in np.asarray(steps, float):
        L = np.linalg.cholesky(odometry_step_covariance(step, accuracy) + 1e-14 * np.eye(3))
        poses.append(compose(poses[-1], step + L @ rng.standard_normal(3)))
    return np.array(poses)
