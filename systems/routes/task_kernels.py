"""Compiled rules of the grid: where a motion ends, and how far each cell is from the goal."""

import math

import numpy as np
from numba import njit

_DX = np.array([1, 1, 0, -1, -1, -1, 0, 1])
_DY = np.array([0, 1, 1, 1, 0, -1, -1, -1])
_FENCE = 6


@njit(cache=True)
def step_to(kind: np.ndarray, x: int, y: int, heading: int) -> int:
    """What is in the way of one step from free cell (x, y): 0 nothing, else the kind of cell.

    A diagonal step also needs both cells beside it, or the robot would cut a corner.
    """
    dx, dy = _DX[heading], _DY[heading]
    for a, b in ((dx, dy), (dx, 0), (0, dy)):
        i, j = x + a, y + b
        if i < 0 or j < 0 or i >= kind.shape[0] or j >= kind.shape[1]:
            return _FENCE
        if kind[i, j] != 0:
            return int(kind[i, j])
    return 0


@njit(cache=True)
def transition_table(
    kind: np.ndarray,
    cost: np.ndarray,
    goal: np.ndarray,
    cells: np.ndarray,
    veer: np.ndarray,
    turn: np.ndarray,
    terrain: np.ndarray,
    rewards: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Successor and reward of every state, motion and outcome, both (nx ny 8, 4, O).

    Args:
        goal: (nx, ny) bool, where the episode ends.
        rewards: goal, per metre through a cell of cost 1 (times the edge of a cell: per step), per motion on the
            spot, then those of bumping into kinds 0 to 6.

    Returns:
        Successors, int32, -1 for the goal; rewards. States at the goal or not free lead to themselves for nothing.
    """
    nx, ny = kind.shape
    outcomes = cells.shape[2]
    successor = np.empty((nx * ny * 8, 4, outcomes), np.int32)
    reward = np.zeros((nx * ny * 8, 4, outcomes))
    for x in range(nx):
        for y in range(ny):
            for theta in range(8):
                s = (x * ny + y) * 8 + theta
                successor[s] = s
                if kind[x, y] != 0 or goal[x, y]:
                    continue
                k = terrain[x, y]
                for a in range(4):
                    for o in range(outcomes):
                        heading = (theta + veer[k, a, o]) % 8
                        length = math.sqrt(2.0) if heading % 2 else 1.0
                        i, j, gained, reached, moved = x, y, 0.0, False, False
                        for _ in range(cells[k, a, o]):
                            wall = step_to(kind, i, j, heading)
                            if wall != 0:
                                gained += rewards[3 + wall]
                                break
                            i2, j2 = i + _DX[heading], j + _DY[heading]
                            gained -= rewards[1] * length * 0.5 * (cost[i, j] + cost[i2, j2])
                            i, j, moved = i2, j2, True
                            if goal[i, j]:
                                gained += rewards[0]
                                reached = True
                                break
                        if not moved:
                            gained -= rewards[2]
                        reward[s, a, o] = gained
                        successor[s, a, o] = -1 if reached else (i * ny + j) * 8 + (theta + turn[k, a, o]) % 8
    return successor, reward


@njit(cache=True)
def distance_field(kind: np.ndarray, cost: np.ndarray, goal: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ways over the cells to the goal that need no turning: a bound for those of the robot.

    Returns:
        (nx, ny) length in cells times cost, inf where there is no way; (nx, ny) steps of the way with the fewest,
        -1 where there is none; (R,) the reachable cells, flat, by rising length.
    """
    nx, ny = kind.shape
    length = np.full((nx, ny), np.inf)
    heap_key = np.empty(nx * ny * 9)
    heap_cell = np.empty(nx * ny * 9, np.int64)
    size = 0
    hops = np.full((nx, ny), -1)
    queue = np.empty(nx * ny, np.int64)
    head, tail = 0, 0
    for x in range(nx):
        for y in range(ny):
            if goal[x, y] and kind[x, y] == 0:
                length[x, y] = 0.0
                hops[x, y] = 0
                heap_key[size], heap_cell[size] = 0.0, x * ny + y  # equal keys are a heap
                size += 1
                queue[tail] = x * ny + y
                tail += 1
    while head < tail:
        x, y = queue[head] // ny, queue[head] % ny
        head += 1
        for heading in range(8):
            if step_to(kind, x, y, heading) == 0:
                i, j = x + _DX[heading], y + _DY[heading]
                if hops[i, j] < 0:
                    hops[i, j] = hops[x, y] + 1
                    queue[tail] = i * ny + j
                    tail += 1
    order = np.empty(nx * ny, np.int64)
    done = np.zeros((nx, ny), np.bool_)
    found = 0
    while size > 0:
        cell = heap_cell[0]
        size -= 1
        _sift_down(heap_key, heap_cell, size, heap_key[size], heap_cell[size])
        x, y = cell // ny, cell % ny
        if done[x, y]:
            continue
        done[x, y] = True
        order[found] = cell
        found += 1
        for heading in range(8):
            if step_to(kind, x, y, heading) != 0:
                continue
            i, j = x + _DX[heading], y + _DY[heading]
            step = math.sqrt(2.0) if heading % 2 else 1.0
            reach = length[x, y] + step * 0.5 * (cost[x, y] + cost[i, j])
            if reach < length[i, j]:
                length[i, j] = reach
                _sift_up(heap_key, heap_cell, size, reach, i * ny + j)
                size += 1
    return length, hops, order[:found]


@njit(cache=True)
def _sift_up(keys: np.ndarray, cells: np.ndarray, at: int, key: float, cell: int) -> None:
    while at > 0:
        parent = (at - 1) // 2
        if keys[parent] <= key:
            break
        keys[at], cells[at] = keys[parent], cells[parent]
        at = parent
    keys[at], cells[at] = key, cell


@njit(cache=True)
def _sift_down(keys: np.ndarray, cells: np.ndarray, size: int, key: float, cell: int) -> None:
    at = 0
    while True:
        child = 2 * at + 1
        if child >= size:
            break
        if child + 1 < size and keys[child + 1] < keys[child]:
            child += 1
        if keys[child] >= key:
            break
        keys[at], cells[at] = keys[child], cells[child]
        at = child
    keys[at], cells[at] = key, cell
