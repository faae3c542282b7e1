"""Shortest ways on a grid, one for every way past its islands."""

import heapq

import numpy as np
from numba import njit

DX = np.array([1, 1, 0, -1, -1, -1, 0, 1])
DY = np.array([0, 1, 1, 1, 0, -1, -1, -1])


@njit(cache=True)
def crossing(table: np.ndarray, x: int, y: int, dx: int, dy: int) -> int:
    """Weight of the rays that a move by (dx, dy) from cell (x, y) crosses."""
    if dx == 0:
        return 0
    j = y + 1 if dy > 0 else y
    return table[x, j] if dx > 0 else -table[x - 1, j]


@njit(cache=True)
def tree(
    start: int, weight: np.ndarray, moves: np.ndarray, table: np.ndarray, backwards: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cheapest ways between one cell and all others (Dijkstra).

    Args:
        start: cell x · ny + y. weight: (nx, ny) cost of a way of one cell through each.
        moves: (nx, ny, 8) bool, which of the eight steps may be made. table: of `Islands`.
        backwards: ways lead to `start`, not from it.

    Returns:
        (nx · ny,) each: cost (inf: no way), the next cell towards `start` (-1), weight of the rays that are crossed
        on the way from or to `start`.
    """
    nx, ny = weight.shape
    cost = np.full(nx * ny, np.inf)
    towards = np.full(nx * ny, -1, np.int64)
    crossed = np.zeros(nx * ny, np.int64)
    cost[start] = 0.0
    heap = [(0.0, start)]
    while len(heap) > 0:
        c, cell = heapq.heappop(heap)
        if c > cost[cell]:
            continue
        x, y = cell // ny, cell % ny
        for a in range(8):
            u, v = x + DX[a], y + DY[a]
            if u < 0 or v < 0 or u >= nx or v >= ny:
                continue
            if not (moves[u, v, (a + 4) % 8] if backwards else moves[x, y, a]):
                continue
            length = 1.4142135623730951 if a % 2 else 1.0
            new = c + 0.5 * length * (weight[x, y] + weight[u, v])
            other = u * ny + v
            if new < cost[other]:
                cost[other] = new
                towards[other] = cell
                over = crossing(table, x, y, DX[a], DY[a])
                crossed[other] = crossed[cell] + (-over if backwards else over)
                heapq.heappush(heap, (new, other))
    return cost, towards, crossed


@njit(cache=True)
def _meets_itself(state: int, cells: np.ndarray, parents: np.ndarray, ny: int) -> bool:
    """Whether the way to a state comes to its last cell a second time, or crosses its last step."""
    cell, before = cells[state], cells[parents[state]] if parents[state] >= 0 else -1
    side_a, side_b = -1, -1
    if before >= 0:
        x, y, u, v = before // ny, before % ny, cell // ny, cell % ny
        if x != u and y != v:
            side_a, side_b = x * ny + v, u * ny + y
    ancestor = parents[state]
    while ancestor >= 0:
        here = cells[ancestor]
        if here == cell:
            return True
        if here in (side_a, side_b) and parents[ancestor] >= 0:
            other = cells[parents[ancestor]]
            if (here == side_a and other == side_b) or (here == side_b and other == side_a):
                return True
        ancestor = parents[ancestor]
    return False


@njit(cache=True)
def best_of_each_class(
    start: int,
    goal: int,
    weight: np.ndarray,
    moves: np.ndarray,
    table: np.ndarray,
    to_go: np.ndarray,
    most: int,
    limit: float,
    states: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The cheapest ways from `start` to `goal` that have different signatures and do not meet themselves.

    A* over cells × signatures with the exact cost to go, regardless of the signature, as the bound. A cell is left by
    the `most` cheapest signatures that reach it: of the `most` best ways to the goal none needs more.

    Args:
        to_go: (nx · ny,) cost from each cell to the goal, as of `tree`.
        most: number of ways. limit: highest cost of a way. states: most states that are looked at.

    Returns:
        (n,) last state of each way, cheapest first; (S,) cell and (S,) parent of each state.
    """
    nx, ny = weight.shape
    cells = np.empty(states, np.int64)
    parents = np.empty(states, np.int64)
    costs = np.empty(states)
    crossed = np.empty(states, np.int64)
    seen = np.zeros((nx * ny, most), np.int64)
    count = np.zeros(nx * ny, np.int64)
    found = np.empty(most, np.int64)
    ways = 0
    cells[0], parents[0], costs[0], crossed[0] = start, -1, 0.0, 0
    size = 1
    heap = [(to_go[start], 0)]
    while len(heap) > 0 and ways < most:
        _, state = heapq.heappop(heap)
        cell = cells[state]
        known = count[cell] >= most
        for k in range(count[cell]):
            known = known or seen[cell, k] == crossed[state]
        if known or _meets_itself(state, cells, parents, ny):
            continue
        seen[cell, count[cell]] = crossed[state]
        count[cell] += 1
        if cell == goal:
            found[ways] = state
            ways += 1
            continue
        x, y = cell // ny, cell % ny
        for a in range(8):
            if not moves[x, y, a]:
                continue
            u, v = x + DX[a], y + DY[a]
            other = u * ny + v
            length = 1.4142135623730951 if a % 2 else 1.0
            cost = costs[state] + 0.5 * length * (weight[x, y] + weight[u, v])
            if cost + to_go[other] > limit or count[other] >= most:
                continue
            if size == states:
                return found[:ways], cells[:size], parents[:size]
            cells[size], parents[size], costs[size] = other, state, cost
            crossed[size] = crossed[state] + crossing(table, x, y, DX[a], DY[a])
            heapq.heappush(heap, (cost + to_go[other], size))
            size += 1
    return found[:ways], cells[:size], parents[:size]
