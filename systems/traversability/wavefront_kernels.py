"""Compiled parts of the wavefront: distance to obstacles, price of cells, cost to the goal, descent, straight lines."""

import math

import numpy as np
from numba import njit

_DI = np.array([1, -1, 0, 0, 1, 1, -1, -1])
_DJ = np.array([0, 0, 1, -1, 1, -1, 1, -1])
_DIAGONAL = math.sqrt(2.0)


@njit(cache=True)
def obstacle_distance(obstacle: np.ndarray, most: float) -> np.ndarray:
    """Distance of every cell to the nearest obstacle's cell [cells], (nx, ny) float32; `most` where it is farther."""
    nx, ny = obstacle.shape
    square = np.full((nx, ny), most * most)
    reach = math.ceil(most)
    for i in range(nx):
        for j in range(ny):
            if not obstacle[i, j]:
                continue
            square[i, j] = 0.0
            inner = 0 < i < nx - 1 and 0 < j < ny - 1
            if inner and obstacle[i - 1, j] and obstacle[i + 1, j] and obstacle[i, j - 1] and obstacle[i, j + 1]:
                continue
            for p in range(max(i - reach, 0), min(i + reach + 1, nx)):
                for q in range(max(j - reach, 0), min(j + reach + 1, ny)):
                    square[p, q] = min(square[p, q], float((p - i) * (p - i) + (q - j) * (q - j)))
    return np.sqrt(square).astype(np.float32)


@njit(cache=True)
def prices(
    risk: np.ndarray,
    distance: np.ndarray,
    limit: float,
    share: float,
    unknown: float,
    hard: float,
    soft: float,
    narrow: float,
) -> np.ndarray:
    """Price of driving one cell's length, (nx, ny) float32, at least 1; infinite where the robot cannot be.

    Known ground costs 1 / (1 - r / r_limit), the time that Eq. 9 makes of it; from `soft` to `hard` cells from an
    obstacle up to `narrow` times that.
    """
    nx, ny = risk.shape
    price = np.full((nx, ny), np.inf, np.float32)
    for i in range(nx):
        for j in range(ny):
            r, d = risk[i, j], distance[i, j]
            if d <= hard or r >= limit:
                continue
            p = unknown if np.isnan(r) else 1.0 / max(1.0 - r / limit, share)
            price[i, j] = p * (1.0 + (narrow - 1.0) * (soft - d) / (soft - hard)) if d < soft else p
    return price


@njit(cache=True)
def _edge(price: np.ndarray, i: int, j: int, n: int) -> float:
    """Cost of the step in direction `n` from cell (i, j); infinite off the grid, into and past blocked cells."""
    p, q = i + _DI[n], j + _DJ[n]
    if p < 0 or q < 0 or p >= price.shape[0] or q >= price.shape[1]:
        return np.inf
    mean = 0.5 * (price[i, j] + price[p, q])
    if n < 4:
        return mean
    return _DIAGONAL * mean if np.isfinite(price[p, j]) and np.isfinite(price[i, q]) else np.inf


@njit(cache=True)
def costs_to_goal(price: np.ndarray, seeds: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Least cost from every cell to the seeds [cells], (nx, ny) float32, infinite where there is no way.

    Dijkstra with buckets one cell wide: no step costs less than 1, so that what is in one bucket does not change any
    more, in whatever order it is taken.

    Args:
        seeds: (n,) flat indices. start: (n,) their costs, not negative.
    """
    nx, ny = price.shape
    # A border of blocked cells around the grid: no neighbour needs to be asked whether it is on it.
    row = ny + 2
    priced = np.full((nx + 2) * row, np.inf, np.float32)
    dearest = 1.0
    for i in range(nx):
        for j in range(ny):
            priced[(i + 1) * row + j + 1] = price[i, j]
            if np.isfinite(price[i, j]):
                dearest = max(dearest, price[i, j])
    cost = np.full((nx + 2) * row, np.inf, np.float32)
    done = np.zeros((nx + 2) * row, np.bool_)
    spread = start.max() - start.min() if len(start) else 0.0
    buckets = int(max(_DIAGONAL * dearest, spread)) + 3
    head = np.full(buckets, -1, np.int32)
    # Every step is taken once at most, and every seed.
    node = np.empty(8 * nx * ny + len(seeds), np.int32)
    follower = np.empty(8 * nx * ny + len(seeds), np.int32)
    used, waiting, level = 0, 0, 0
    for s in range(len(seeds)):
        c = (seeds[s] // ny + 1) * row + seeds[s] % ny + 1
        if priced[c] < np.inf and start[s] < cost[c]:
            cost[c] = start[s]
            b = int(cost[c]) % buckets
            node[used], follower[used], head[b] = c, head[b], used
            used += 1
            waiting += 1
    if len(start):
        level = int(start.min())
    while waiting > 0:
        entry = head[level % buckets]
        head[level % buckets] = -1
        while entry >= 0:
            c = node[entry]
            entry = follower[entry]
            waiting -= 1
            if done[c]:
                continue
            done[c] = True
            for n in range(8):
                down, right = _DI[n] * row, _DJ[n]
                # Not past the corner of a blocked cell; `_edge` says the same of cells that may be off the grid.
                if n >= 4 and not (priced[c + down] < np.inf and priced[c + right] < np.inf):
                    continue
                d = c + down + right
                mean = 0.5 * (priced[c] + priced[d])
                total = np.float32(cost[c] + (mean if n < 4 else _DIAGONAL * mean))
                if total < cost[d]:
                    cost[d] = total
                    b = int(total) % buckets
                    node[used], follower[used], head[b] = d, head[b], used
                    used += 1
                    waiting += 1
        level += 1
    return cost.reshape(nx + 2, row)[1:-1, 1:-1].copy()


@njit(cache=True)
def descend(cost: np.ndarray, price: np.ndarray, cell: float, i: int, j: int, steps: int) -> np.ndarray:
    """Cells of the cheapest way from cell (i, j) towards the goal, (n, 2), n <= steps + 1.

    Args:
        cost: to the goal, in units of which a cell is `cell` long.
    """
    path = np.empty((steps + 1, 2), np.int64)
    path[0, 0], path[0, 1] = i, j
    for k in range(steps):
        best, to = np.inf, -1
        for n in range(8):
            step = _edge(price, i, j, n)
            if np.isfinite(step):
                total = step * cell + cost[i + _DI[n], j + _DJ[n]]
                if total < best:
                    best, to = total, n
        if to < 0 or not cost[i + _DI[to], j + _DJ[to]] < cost[i, j]:
            return path[: k + 1]
        i, j = i + _DI[to], j + _DJ[to]
        path[k + 1, 0], path[k + 1, 1] = i, j
    return path


@njit(cache=True)
def line(price: np.ndarray, risk: np.ndarray, x0: float, y0: float, x1: float, y1: float) -> tuple[float, float, bool]:
    """Cost, highest risk and whether all is known along a straight line [cells]; infinite cost where it is blocked.

    Cells outside the grid are not known and cost nothing.
    """
    length = math.hypot(x1 - x0, y1 - y0)
    pieces = max(1, math.ceil(2.0 * length))
    total, worst, known = 0.0, 0.0, True
    for k in range(pieces + 1):
        i, j = math.floor(x0 + (x1 - x0) * k / pieces), math.floor(y0 + (y1 - y0) * k / pieces)
        if i < 0 or j < 0 or i >= price.shape[0] or j >= price.shape[1]:
            known = False
            continue
        total += price[i, j] * (0.5 if k == 0 or k == pieces else 1.0)
        if np.isnan(risk[i, j]):
            known = False
        else:
            worst = max(worst, risk[i, j])
    return total * length / pieces, worst, known
