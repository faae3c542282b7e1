"""Loops over points that make a `View`, compiled."""

import numpy as np
from numba import njit


@njit(cache=True)
def range_image(points: np.ndarray, seen_from: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """Distance of the nearest of `points` (N, 3) by elevation and azimuth, (rows, columns) [m]; inf where is none."""
    image = np.full((rows, columns), np.inf)
    for i in range(len(points)):
        x, y, z = points[i, 0] - seen_from[0], points[i, 1] - seen_from[1], points[i, 2] - seen_from[2]
        distance = np.sqrt(x * x + y * y + z * z)
        if distance < 1e-6:
            continue
        row, column = pixel(x, y, z, distance, rows, columns)
        image[row, column] = min(image[row, column], distance)
    return image


@njit(cache=True)
def pixel(x: float, y: float, z: float, distance: float, rows: int, columns: int) -> tuple[int, int]:
    """Row (elevation) and column (azimuth) of a direction in an image of the whole sphere."""
    row = int((np.arcsin(min(max(z / distance, -1.0), 1.0)) / np.pi + 0.5) * rows)
    column = int((np.arctan2(y, x) / (2 * np.pi) + 0.5) * columns)
    return min(row, rows - 1), column % columns


@njit(cache=True)
def nearest_cells(centres: np.ndarray, cell: float, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Table (nx, ny) int32 of the nearest of `centres` (M, 2) for each cell within `reach`, −1 if none; its corner."""
    if len(centres) == 0:
        return np.full((1, 1), np.int32(-1)), np.zeros(2)
    margin = reach + cell
    low0, low1 = centres[:, 0].min() - margin, centres[:, 1].min() - margin
    nx = int((centres[:, 0].max() + margin - low0) / cell) + 1
    ny = int((centres[:, 1].max() + margin - low1) / cell) + 1
    table = np.full((nx, ny), np.int32(-1))
    nearest = np.full((nx, ny), reach * reach)
    span = int(np.ceil(reach / cell))
    for i in range(len(centres)):
        x, y = centres[i, 0] - low0, centres[i, 1] - low1
        ix, iy = int(x / cell), int(y / cell)
        for jx in range(max(ix - span, 0), min(ix + span + 1, nx)):
            for jy in range(max(iy - span, 0), min(iy + span + 1, ny)):
                dx, dy = (jx + 0.5) * cell - x, (jy + 0.5) * cell - y
                square = dx * dx + dy * dy
                if square < nearest[jx, jy]:
                    nearest[jx, jy] = square
                    table[jx, jy] = i
    return table, np.array([low0, low1])


@njit(cache=True)
def column_moments(keys: np.ndarray, sums: np.ndarray, eye: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normals (M, 2) towards `eye` and flatness (M,) of columns, over each and its eight neighbours.

    Args:
        keys: sorted, x index << 32 | y index, (M,) int64.
        sums: count, x, y, xx, xy, yy of each, (M, 6).
    """
    normals, flatness = np.zeros((len(keys), 2)), np.zeros(len(keys))
    total = np.zeros(6)
    for i in range(len(keys)):
        total[:] = 0.0
        for dx in range(-1, 2):
            first = keys[i] + (np.int64(dx) << 32) - 1
            k = np.searchsorted(keys, first)
            while k < len(keys) and keys[k] <= first + 2:
                total += sums[k]
                k += 1
        n = total[0]
        mx, my = total[1] / n, total[2] / n
        xx, xy, yy = total[3] / n - mx * mx, total[4] / n - mx * my, total[5] / n - my * my
        middle, half = (xx + yy) / 2, np.sqrt(((xx - yy) / 2) ** 2 + xy * xy)
        angle = 0.5 * np.arctan2(2 * xy, xx - yy)  # of the line
        normal_x, normal_y = -np.sin(angle), np.cos(angle)
        to_x, to_y = eye[0] - sums[i, 1] / sums[i, 0], eye[1] - sums[i, 2] / sums[i, 0]
        line = 1.0 - max(middle - half, 0.0) / max(middle + half, 1e-12)
        if n < 4 or middle + half < 0.01**2 or half < 1e-9:
            line = 0.0
            size = max(np.sqrt(to_x * to_x + to_y * to_y), 1e-9)
            normal_x, normal_y = to_x / size, to_y / size
        sign = 1.0 if normal_x * to_x + normal_y * to_y >= 0 else -1.0
        normals[i, 0], normals[i, 1] = sign * normal_x, sign * normal_y
        flatness[i] = line
    return normals, flatness
