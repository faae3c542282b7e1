"""Compiled features of every cell of a map: a plane through the window around it, and the steps at it."""

import math

import numpy as np
from numba import njit

from .feature_kernels import solve_plane


@njit(cache=True)
def bounds(points: np.ndarray) -> tuple[float, float, float, float]:
    """Lowest and highest x and y of the points that are finite; zeros without any."""
    x0, x1, y0, y1 = np.inf, -np.inf, np.inf, -np.inf
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        if np.isfinite(x) and np.isfinite(y) and np.isfinite(z):
            x0, x1, y0, y1 = min(x0, x), max(x1, x), min(y0, y), max(y1, y)
    if x1 < x0:
        return 0.0, 0.0, 0.0, 0.0
    return x0, x1, y0, y1


@njit(cache=True)
def _median_of_nine(z: np.ndarray, i: int, j: int) -> float:
    """Median of the known heights of a cell and those around it."""
    held = 0
    values = np.empty(9)
    for a in range(max(i - 1, 0), min(i + 2, z.shape[0])):
        for b in range(max(j - 1, 0), min(j + 2, z.shape[1])):
            value = z[a, b]
            if np.isfinite(value):
                n = held
                while n > 0 and values[n - 1] > value:
                    values[n] = values[n - 1]
                    n -= 1
                values[n] = value
                held += 1
    return values[held // 2]


@njit(cache=True)
def window_features(
    low: np.ndarray, high: np.ndarray, left_out: np.ndarray, cell: float, half: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Slope [rad], roughness [m²], coverage and height [m] of every cell, from the window of ±`half` cells around it.

    The height of a cell that was not seen is the mean of two opposite ones that were. Cells that are `left_out` (bool)
    are seen but are not ground: they count for the coverage alone.
    """
    nx, ny = low.shape
    z = np.full((nx, ny), np.nan)
    height = np.full((nx, ny), np.nan, np.float32)
    for i in range(nx):
        for j in range(ny):
            if np.isfinite(low[i, j]):
                height[i, j] = low[i, j]
                z[i, j] = _median_of_nine(low, i, j)
            elif 0 < i < nx - 1 and np.isfinite(low[i - 1, j]) and np.isfinite(low[i + 1, j]):
                height[i, j] = 0.5 * (low[i - 1, j] + low[i + 1, j])
            elif 0 < j < ny - 1 and np.isfinite(low[i, j - 1]) and np.isfinite(low[i, j + 1]):
                height[i, j] = 0.5 * (low[i, j - 1] + low[i, j + 1])
    slope = np.full((nx, ny), np.nan, np.float32)
    roughness = np.full((nx, ny), np.nan, np.float32)
    coverage = np.zeros((nx, ny), np.float32)
    moments, columns = np.zeros(10), np.zeros((ny, 10))
    full, middle = (2 * half + 1) ** 2, 0.5 * (low + high)
    for i in range(nx):
        # Sums over the rows of the window, column by column, about this row; then a running sum over the columns.
        columns[:] = 0.0
        first, last = max(i - half, 0), min(i + half + 1, nx)
        for p in range(first, last):
            x = (p - i) * cell
            for j in range(ny):
                if np.isfinite(z[p, j]):
                    columns[j, 9] += 1.0
                    if left_out[p, j]:
                        continue
                    y, h = j * cell, z[p, j]
                    columns[j, 0] += 1.0
                    columns[j, 1] += x
                    columns[j, 2] += y
                    columns[j, 3] += h
                    columns[j, 4] += x * x
                    columns[j, 5] += x * y
                    columns[j, 6] += y * y
                    columns[j, 7] += x * h
                    columns[j, 8] += y * h
        moments[:] = 0.0
        for j in range(min(half, ny)):
            moments += columns[j]
        for j in range(ny):
            if j + half < ny:
                moments += columns[j + half]
            if j - half - 1 >= 0:
                moments -= columns[j - half - 1]
            coverage[i, j] = moments[9] / full
            if moments[0] < 2.5 or not np.isfinite(height[i, j]):
                continue
            a, b, c, found = solve_plane(moments)
            if not found:
                continue
            slope[i, j] = math.atan(math.sqrt(a * a + b * b))
            norm, distance, square, count = math.sqrt(a * a + b * b + 1.0), 0.0, 0.0, 0
            for p in range(first, last):
                for q in range(max(j - half, 0), min(j + half + 1, ny)):
                    h = middle[p, q]
                    if np.isfinite(h) and not left_out[p, q]:
                        d = abs(a * (p - i) * cell + b * q * cell + c - h)
                        distance += d
                        square += d * d
                        count += 1
            mean = distance / count
            roughness[i, j] = max(square / count - mean * mean, 0.0) / (norm * norm)
    return slope, roughness, coverage, height
