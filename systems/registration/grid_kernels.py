"""Points sorted into the cells of a hashed grid, in numba."""

import numpy as np
from numba import njit

# A cell's three indices are packed in 63 bits. Those that do not fit wrap round; who searches compares distances.
_BITS = 21
_MASK = (1 << _BITS) - 1
_EMPTY = -1


@njit(cache=True)
def within(points: np.ndarray, farthest: float) -> np.ndarray:
    """Which of the points (N, 3) have no coordinate beyond ±`farthest`, nor NaN."""
    inside = np.empty(len(points), np.bool_)
    for p in range(len(points)):
        inside[p] = abs(points[p, 0]) < farthest and abs(points[p, 1]) < farthest and abs(points[p, 2]) < farthest
    return inside


@njit(cache=True)
def cell_key(i: int, j: int, k: int) -> int:
    """The three indices of a cell in one number."""
    return ((i & _MASK) << (2 * _BITS)) | ((j & _MASK) << _BITS) | (k & _MASK)


@njit(cache=True)
def find_slot(keys: np.ndarray, key: int) -> int:
    """Where `key` is in the table `keys`, or the empty slot where it would go. The table is a power of two long."""
    mask = len(keys) - 1
    mixed = key * -7046029254386353131  # 2^64 / golden ratio: Fibonacci hashing
    slot = (mixed ^ (mixed >> 32)) & mask
    while keys[slot] != key and keys[slot] != _EMPTY:
        slot = (slot + 1) & mask
    return slot


@njit(cache=True)
def sort_into_cells(points: np.ndarray, cell: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Sorts points (N, 3) by the cell, of edge length `cell`, that they are in.

    Returns:
        keys: the table of cells, see `find_slot`; -1 where empty.
        ends: (len(keys), 2) int32, where the points of each cell start and end in `order`.
        order: (N,) int32, the points cell by cell, cells in the order in which they first appear.
        cells: how many there are.
    """
    size = 16
    while size < 2 * len(points):
        size *= 2
    keys = np.full(size, _EMPTY, np.int64)
    ends = np.zeros((size, 2), np.int32)
    slots = np.empty(len(points), np.int32)
    found = np.empty(len(points), np.int32)
    cells = 0
    for p in range(len(points)):
        i, j, k = np.floor(points[p, 0] / cell), np.floor(points[p, 1] / cell), np.floor(points[p, 2] / cell)
        key = cell_key(int(i), int(j), int(k))
        slot = find_slot(keys, key)
        if keys[slot] == _EMPTY:
            keys[slot] = key
            found[cells] = slot
            cells += 1
        slots[p] = slot
        ends[slot, 1] += 1
    start = 0
    for c in range(cells):
        count = ends[found[c], 1]
        ends[found[c], 0] = start
        ends[found[c], 1] = start
        start += count
    order = np.empty(len(points), np.int32)
    for p in range(len(points)):
        order[ends[slots[p], 1]] = p
        ends[slots[p], 1] += 1
    return keys, ends, order, cells


@njit(cache=True)
def cell_means(points: np.ndarray, weights: np.ndarray, cell: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean of the points (N, 3) with their weights (N,), its weight and the first point's index of every occupied cell.

    They are (C, 3), (C,) and (C,), in the order of the cells' first points.
    """
    _, ends, order, cells = sort_into_cells(points, cell)
    means = np.zeros((cells, 3))
    total = np.zeros(cells)
    first = np.zeros(cells, np.int32)
    # `order` goes cell by cell, so a new cell starts where the previous one ends.
    starts = np.zeros(len(points), np.bool_)
    for slot in range(len(ends)):
        if ends[slot, 1] > ends[slot, 0]:
            starts[ends[slot, 0]] = True
    c = -1
    for o in range(len(points)):
        p = order[o]
        if starts[o]:
            c += 1
            first[c] = p
        total[c] += weights[p]
        for axis in range(3):
            means[c, axis] += weights[p] * points[p, axis]
    for c in range(cells):
        for axis in range(3):
            means[c, axis] /= total[c]
    return means, total, first
