"""Compiled rays over a grid of cells: ranges, lines of sight, lines that keep to free cells. All in cells, x along
columns, y along rows."""

import math

import numpy as np
from numba import njit

_FAR = 1e18


@njit(cache=True)
def cast_ray(occupied: np.ndarray, x: float, y: float, dx: float, dy: float, reach: float) -> tuple[float, int, int]:
    """Distance to the first occupied cell along the unit direction dx, dy, and that cell (row, column).

    Exact: walks from cell to cell (Amanatides and Woo 1987). The distance is infinite, and the cell -1, -1, when there
    is none within `reach` or on the grid; it is 0 from inside an occupied cell.
    """
    rows, cols = occupied.shape
    j, i = math.floor(x), math.floor(y)
    step_j, step_i = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    per_j = 1.0 / abs(dx) if dx != 0.0 else _FAR
    per_i = 1.0 / abs(dy) if dy != 0.0 else _FAR
    next_j = ((j + 1 - x) if dx > 0 else (x - j)) * per_j if dx != 0.0 else _FAR
    next_i = ((i + 1 - y) if dy > 0 else (y - i)) * per_i if dy != 0.0 else _FAR
    distance = 0.0
    while distance <= reach:
        if i < 0 or j < 0 or i >= rows or j >= cols:
            return np.inf, -1, -1
        if occupied[i, j]:
            return distance, i, j
        if next_j < next_i:
            distance = next_j
            next_j += per_j
            j += step_j
        else:
            distance = next_i
            next_i += per_i
            i += step_i
    return np.inf, -1, -1


@njit(cache=True)
def is_clear(blocked: np.ndarray, x0: float, y0: float, x1: float, y1: float) -> bool:
    """Whether a straight line touches no blocked cell and stays on the grid."""
    rows, cols = blocked.shape
    for x, y in ((x0, y0), (x1, y1)):
        if x < 0 or y < 0 or x >= cols or y >= rows or blocked[int(y), int(x)]:
            return False
    length = math.hypot(x1 - x0, y1 - y0)
    if length == 0.0:
        return True
    return cast_ray(blocked, x0, y0, (x1 - x0) / length, (y1 - y0) / length, length)[0] == np.inf


@njit(cache=True)
def sees(occupied: np.ndarray, x0: float, y0: float, x1: float, y1: float, slack: float, reach: float) -> bool:
    """Whether nothing is between two points nearer to the first than `slack` [cells] before the second one."""
    length = math.hypot(x1 - x0, y1 - y0)
    if length > reach:
        return False
    if length <= slack:
        return True
    distance, _, _ = cast_ray(occupied, x0, y0, (x1 - x0) / length, (y1 - y0) / length, length)
    return distance >= length - slack


@njit(cache=True)
def sight_table(occupied: np.ndarray, eyes: np.ndarray, targets: np.ndarray, slack: float, reach: float) -> np.ndarray:
    """(n, m) whether the points `eyes` (n, 2) x, y see the `targets` (m, 2), all in cells."""
    table = np.zeros((len(eyes), len(targets)), np.bool_)
    for a in range(len(eyes)):
        for b in range(len(targets)):
            table[a, b] = sees(occupied, eyes[a, 0], eyes[a, 1], targets[b, 0], targets[b, 1], slack, reach)
    return table


@njit(cache=True)
def clear_table(blocked: np.ndarray, points: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """(k,) whether the lines between pairs (k, 2) of `points` (n, 2) x, y [cells] are clear."""
    clear = np.zeros(len(pairs), np.bool_)
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        clear[k] = is_clear(blocked, points[a, 0], points[a, 1], points[b, 0], points[b, 1])
    return clear


@njit(cache=True)
def straighten(blocked: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Indices of those of `points` (n, 2) x, y [cells] that a way with straight cuts over clear cells needs, first and
    last among them: of the ways that skip points the shortest (dynamic programming)."""
    n = len(points)
    cost = np.full(n, np.inf)
    before = np.full(n, -1, np.int64)
    cost[0] = 0.0
    for b in range(1, n):
        for a in range(b):
            length = math.hypot(points[b, 0] - points[a, 0], points[b, 1] - points[a, 1])
            if cost[a] + length >= cost[b]:
                continue
            if a == b - 1 or is_clear(blocked, points[a, 0], points[a, 1], points[b, 0], points[b, 1]):
                cost[b], before[b] = cost[a] + length, a
    kept = np.zeros(n, np.int64)
    k, at = 0, n - 1
    while at >= 0:
        kept[k] = at
        k += 1
        at = before[at]
    return kept[:k][::-1].copy()
