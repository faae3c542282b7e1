"""Compiled description of walls on a grid: which cells are a face, which way it runs there, how much it bends."""

import math

import numpy as np
from numba import njit

# Cells of the boundary that lie within a window of this half width and are linked with its middle.
_MOST = 4096


@njit(cache=True)
def wall_faces(occupied: np.ndarray, free: np.ndarray) -> np.ndarray:
    """(rows, cols) which occupied cells have one of the `free` cells beside them."""
    rows, cols = occupied.shape
    face = np.zeros((rows, cols), np.bool_)
    for i in range(rows):
        for j in range(cols):
            if not occupied[i, j]:
                continue
            face[i, j] = (
                (i > 0 and free[i - 1, j])
                or (i + 1 < rows and free[i + 1, j])
                or (j > 0 and free[i, j - 1])
                or (j + 1 < cols and free[i, j + 1])
            )
    return face


@njit(cache=True)
def wall_directions(face: np.ndarray, half: int) -> tuple[np.ndarray, np.ndarray]:
    """Direction in which the wall runs at every cell of its face, in [0, π) [rad], and its bend.

    Both are the principal axes of the face's cells that are linked with the cell within `half` cells of it: the
    direction is the larger axis, the bend the ratio of the variances, 0 on a straight wall, about 0.3 in a right
    corner. Both are NaN where there is no face.
    """
    rows, cols = face.shape
    angle = np.full((rows, cols), np.nan, np.float32)
    bend = np.full((rows, cols), np.nan, np.float32)
    side = 2 * half + 1
    mark = np.zeros((side, side), np.int64)
    queue = np.empty((_MOST, 2), np.int64)
    stamp = 0
    for i in range(rows):
        for j in range(cols):
            if not face[i, j]:
                continue
            stamp += 1
            queue[0, 0], queue[0, 1] = i, j
            mark[half, half] = stamp
            n, at = 1, 0
            while at < n:
                p, q = queue[at, 0], queue[at, 1]
                at += 1
                for a in range(max(p - 1, i - half, 0), min(p + 2, i + half + 1, rows)):
                    for b in range(max(q - 1, j - half, 0), min(q + 2, j + half + 1, cols)):
                        u, v = a - i + half, b - j + half
                        if face[a, b] and mark[u, v] != stamp and n < _MOST:
                            mark[u, v] = stamp
                            queue[n, 0], queue[n, 1] = a, b
                            n += 1
            angle[i, j], bend[i, j] = _principal(queue[:n])
    return angle, bend


@njit(cache=True)
def _principal(cells: np.ndarray) -> tuple[float, float]:
    n = len(cells)
    y, x = 0.0, 0.0
    for k in range(n):
        y += cells[k, 0] / n
        x += cells[k, 1] / n
    xx, xy, yy = 0.0, 0.0, 0.0
    for k in range(n):
        u, v = cells[k, 1] - x, cells[k, 0] - y
        xx += u * u
        xy += u * v
        yy += v * v
    spread = math.hypot(xx - yy, 2 * xy)
    if xx + yy <= 0.0:
        return 0.0, 1.0
    direction = 0.5 * math.atan2(2 * xy, xx - yy)
    return direction % math.pi, (xx + yy - spread) / (xx + yy + spread)
