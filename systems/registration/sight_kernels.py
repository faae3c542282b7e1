"""What a sensor saw through, in numba: surfaces that are where it saw farther contradict a pose."""

import math

import numpy as np
from numba import njit

# Directions are told apart by so many steps of azimuth and elevation: 2°, as the rings of a VLP-16.
AZIMUTHS, ELEVATIONS = 180, 90
# [m], [-] Surfaces nearer than what was seen by this, and this part of the distance, were seen through.
_MARGIN, _MARGIN_PART = 0.2, 0.03
# [rad] Width of a direction, and smallest cosine of the incidence: a surface that is met at a slant reaches through one
# direction over a stretch, the floor of a corridor over metres.
_WIDTH, _SLANT = math.pi / ELEVATIONS, 0.05


@njit(cache=True)
def _direction(x: float, y: float, z: float) -> tuple[int, int]:
    azimuth = int((math.atan2(y, x) + math.pi) * (AZIMUTHS / (2 * math.pi)))
    elevation = int((math.atan2(z, math.sqrt(x * x + y * y)) + 0.5 * math.pi) * (ELEVATIONS / math.pi))
    return min(azimuth, AZIMUTHS - 1), min(elevation, ELEVATIONS - 1)


@njit(cache=True)
def nearest_ranges(points: np.ndarray) -> np.ndarray:
    """Distance of the nearest of `points` (N, 3) from the origin in every direction, (AZIMUTHS, ELEVATIONS); 0 where
    there is none."""
    ranges = np.zeros((AZIMUTHS, ELEVATIONS))
    for p in range(len(points)):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        distance = math.sqrt(x * x + y * y + z * z)
        i, j = _direction(x, y, z)
        if ranges[i, j] == 0 or distance < ranges[i, j]:
            ranges[i, j] = distance
    return ranges


@njit(cache=True)
def count_seen(surfels: np.ndarray, X: np.ndarray, ranges: np.ndarray) -> tuple[int, int]:
    """How many of the surfels (N, 8), at the pose X (4, 4) of their cloud in the sensor's frame, are where the sensor
    saw something, and how many are in front of it: it would have seen these."""
    there, through = 0, 0
    for s in range(len(surfels)):
        a, b, c = surfels[s, 0], surfels[s, 1], surfels[s, 2]
        x = X[0, 0] * a + X[0, 1] * b + X[0, 2] * c + X[0, 3]
        y = X[1, 0] * a + X[1, 1] * b + X[1, 2] * c + X[1, 3]
        z = X[2, 0] * a + X[2, 1] * b + X[2, 2] * c + X[2, 3]
        i, j = _direction(x, y, z)
        if ranges[i, j] > 0:
            distance = math.sqrt(x * x + y * y + z * z)
            u, v, w = surfels[s, 3], surfels[s, 4], surfels[s, 5]
            u, v, w = (
                X[0, 0] * u + X[0, 1] * v + X[0, 2] * w,
                X[1, 0] * u + X[1, 1] * v + X[1, 2] * w,
                X[2, 0] * u + X[2, 1] * v + X[2, 2] * w,
            )
            cosine = max(abs(u * x + v * y + w * z) / distance, _SLANT)
            stretch = _WIDTH * distance * math.sqrt(max(1 - cosine * cosine, 0.0)) / cosine
            margin = _MARGIN + _MARGIN_PART * distance + stretch
            if distance < ranges[i, j] - margin:
                through += 1
            elif distance < ranges[i, j] + margin:
                there += 1
    return there, through
