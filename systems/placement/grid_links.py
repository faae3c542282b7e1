"""Ways over the plain grid of a plan, every free cell a node: where the topology leaves a gap, and to compare with."""

import math

import numpy as np
from numba import njit

from .astar import push, sink
from .floor_plan import FloorPlan
from .ray_kernels import straighten

_DI = np.array([1, -1, 0, 0, 1, 1, -1, -1])
_DJ = np.array([0, 0, 1, -1, 1, -1, 1, -1])


def grid_way(plan: FloorPlan, drivable: np.ndarray, start: np.ndarray, goal: np.ndarray) -> np.ndarray | None:
    """Corners (k, 2) [m] between `start` and `goal` (2,) [m] of the way over drivable cells, None without any."""
    cells = grid_path(drivable, plan.cell_of(start), plan.cell_of(goal))
    if not len(cells):
        return None
    points = np.vstack([start, plan.centre_of(cells)[1:-1], goal])
    kept = straighten(~drivable, (points - plan.origin) / plan.resolution)
    return points[kept[1:-1]]


@njit(cache=True)
def grid_path(drivable: np.ndarray, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """(k, 2) cells along the shortest way with steps to the eight neighbours, by A*; empty without any."""
    rows, cols = drivable.shape
    cost = np.full((rows, cols), np.inf)
    before = np.full((rows, cols), -1, np.int8)
    done = np.zeros((rows, cols), np.bool_)
    diagonal = math.sqrt(2.0)
    # Every cell is pushed once from each neighbour at most.
    key = np.empty(8 * rows * cols + 1)
    item = np.empty(8 * rows * cols + 1, np.int64)
    size = 1
    cost[start[0], start[1]] = 0.0
    key[0], item[0] = _octile(start[0], start[1], goal, diagonal), start[0] * cols + start[1]
    while size > 0:
        i, j = item[0] // cols, item[0] % cols
        size -= 1
        sink(key, item, size)
        if done[i, j]:
            continue
        done[i, j] = True
        if i == goal[0] and j == goal[1]:
            break
        for n in range(8):
            p, q = i + _DI[n], j + _DJ[n]
            if p < 0 or q < 0 or p >= rows or q >= cols or not drivable[p, q] or done[p, q]:
                continue
            if n >= 4 and not (drivable[p, j] and drivable[i, q]):
                continue
            total = cost[i, j] + (diagonal if n >= 4 else 1.0)
            if total < cost[p, q]:
                cost[p, q], before[p, q] = total, n
                push(key, item, size, total + _octile(p, q, goal, diagonal), p * cols + q)
                size += 1
    if not np.isfinite(cost[goal[0], goal[1]]):
        return np.zeros((0, 2), np.int64)
    path = np.empty((rows * cols, 2), np.int64)
    i, j, k = goal[0], goal[1], 0
    while True:
        path[k, 0], path[k, 1] = i, j
        k += 1
        n = before[i, j]
        if n < 0:
            return path[:k][::-1].copy()
        i, j = i - _DI[n], j - _DJ[n]


@njit(cache=True)
def _octile(i: int, j: int, goal: np.ndarray, diagonal: float) -> float:
    di, dj = abs(i - goal[0]), abs(j - goal[1])
    return max(di, dj) + (diagonal - 1.0) * min(di, dj)
