"""The shortest order of visits, proved: dynamic programming over sets of points (Held and Karp 1962)."""

import numpy as np
from numba import njit

from ..errors import InputError

MOST_POINTS = 18
"""Points up to which the tables fit in memory: 2^n n numbers."""


def shortest_order(lengths: np.ndarray) -> np.ndarray:
    """Order (n,) of the points 1 … n of the shortest open route from point 0.

    Args:
        lengths: (n + 1, n + 1) of the ways between points [m].

    Raises:
        InputError: there are more than `MOST_POINTS` points.
    """
    n = len(lengths) - 1
    if n > MOST_POINTS:
        raise InputError("too many points for an exact order", key="lengths", value=n, valid=f"at most {MOST_POINTS}")
    return _held_karp(np.ascontiguousarray(lengths, np.float64))


@njit(cache=True)
def _held_karp(lengths: np.ndarray) -> np.ndarray:
    n = len(lengths) - 1
    cost = np.full((1 << n, n), np.inf)
    before = np.full((1 << n, n), -1, np.int8)
    for b in range(n):
        cost[1 << b, b] = lengths[0, b + 1]
    for visited in range(1, 1 << n):
        for a in range(n):
            if not (visited >> a) & 1 or cost[visited, a] == np.inf:
                continue
            for b in range(n):
                if (visited >> b) & 1:
                    continue
                after = visited | (1 << b)
                total = cost[visited, a] + lengths[a + 1, b + 1]
                if total < cost[after, b]:
                    cost[after, b], before[after, b] = total, a
    order = np.empty(n, np.int64)
    visited = (1 << n) - 1
    at = int(np.argmin(cost[visited]))
    for k in range(n - 1, -1, -1):
        order[k] = at + 1
        last = int(before[visited, at])
        visited ^= 1 << at
        at = last
    return order
