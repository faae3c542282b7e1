"""Grounds as clouds of points: a height function, sampled with noise and outliers."""

from collections.abc import Callable

import numpy as np

Height = Callable[[np.ndarray, np.ndarray], np.ndarray]


def ground(
    height: Height,
    *,
    seed: int = 0,
    points: int = 30_000,
    reach: float = 2.0,
    noise: float = 0.01,
    outliers: float = 0.0,
) -> np.ndarray:
    """Points (N, 3) float32 [m] of a ground within ±`reach`; a share of them has any height within 1 m of it."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-reach, reach, (points, 2))
    z = height(*xy.T) + rng.normal(0, noise, points)
    wrong = rng.uniform(size=points) < outliers
    z[wrong] += rng.uniform(-1, 1, wrong.sum())
    return np.column_stack([xy, z]).astype(np.float32)


def plane(slope_deg: float, towards_deg: float = 0.0, height: float = 0.0) -> Height:
    """A plane that rises by `slope_deg` towards a direction."""
    a, b = np.tan(np.deg2rad(slope_deg)) * np.array([np.cos(np.deg2rad(towards_deg)), np.sin(np.deg2rad(towards_deg))])
    return lambda x, y: a * x + b * y + height


def step(height: float, at: float = 0.8) -> Height:
    """A step across the way ahead."""
    return lambda x, y: height * (x > at)


def pole(xy: tuple[float, float], height: float = 0.5, width: float = 0.1) -> np.ndarray:
    """Points all over the sides of an upright square pole, (N, 3) float32."""
    rng = np.random.default_rng(1)
    around = rng.uniform(-0.5, 0.5, (400, 2))
    axis = rng.integers(0, 2, 400)
    around[np.arange(400), axis] = np.sign(around[np.arange(400), axis]) * 0.5
    z = rng.uniform(0, height, 400)
    return np.column_stack([np.array(xy) + width * around, z]).astype(np.float32)
