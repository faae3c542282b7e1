"""Shortest ways over a graph: A* with the straight distance as heuristic, compiled."""

import math

import numpy as np
from numba import njit


@njit(cache=True)
def find_path(
    nodes: np.ndarray, first: np.ndarray, neighbour: np.ndarray, length: np.ndarray, start: int, goal: int
) -> tuple[np.ndarray, float]:
    """The shortest way from node `start` to node `goal` (Hart, Nilsson and Raphael 1968).

    Args:
        nodes: (n, 2) positions; no link is shorter than its nodes are apart.
        first: (n + 1,) where each node's links begin in neighbour and length (m,).

    Returns:
        Indices of the nodes along the way, both ends among them, and its length; none and infinite without a way.
    """
    n = len(nodes)
    cost = np.full(n, np.inf)
    before = np.full(n, -1, np.int64)
    done = np.zeros(n, np.bool_)
    # Every link is pushed once at most.
    key = np.empty(len(neighbour) + 1)
    item = np.empty(len(neighbour) + 1, np.int64)
    size = 1
    gx, gy = nodes[goal, 0], nodes[goal, 1]
    cost[start] = 0.0
    key[0], item[0] = math.sqrt((gx - nodes[start, 0]) ** 2 + (gy - nodes[start, 1]) ** 2), start
    while size > 0:
        a = item[0]
        size -= 1
        sink(key, item, size)
        if done[a]:
            continue
        if a == goal:
            break
        done[a] = True
        for e in range(first[a], first[a + 1]):
            b = neighbour[e]
            total = cost[a] + length[e]
            if total < cost[b]:
                cost[b], before[b] = total, a
                ahead = math.sqrt((gx - nodes[b, 0]) ** 2 + (gy - nodes[b, 1]) ** 2)
                push(key, item, size, total + ahead, b)
                size += 1
    if not np.isfinite(cost[goal]):
        return np.zeros(0, np.int64), np.inf
    path = np.empty(n, np.int64)
    k, at = 0, goal
    while at >= 0:
        path[k] = at
        k += 1
        at = before[at]
    return path[:k][::-1].copy(), cost[goal]


@njit(cache=True)
def push(key: np.ndarray, item: np.ndarray, size: int, value: float, what: int) -> None:
    """Adds to a binary heap of `size` entries."""
    at = size
    while at > 0 and key[(at - 1) // 2] > value:
        key[at], item[at] = key[(at - 1) // 2], item[(at - 1) // 2]
        at = (at - 1) // 2
    key[at], item[at] = value, what


@njit(cache=True)
def sink(key: np.ndarray, item: np.ndarray, size: int) -> None:
    """Closes the hole at the top of the heap with its last entry, which is at `size`."""
    value, what = key[size], item[size]
    at = 0
    while 2 * at + 1 < size:
        child = 2 * at + 1
        if child + 1 < size and key[child + 1] < key[child]:
            child += 1
        if key[child] >= value:
            break
        key[at], item[at] = key[child], item[child]
        at = child
    key[at], item[at] = value, what
