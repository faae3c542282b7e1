"""Leaves of an octree in Morton order, and the bytes in which OctoMap stores the tree above them."""

from dataclasses import dataclass

import numpy as np
from numba import njit

# OctoMap's trees have 16 levels below the root: voxels from -2^15 to 2^15 - 1 along each axis.
DEPTH = 16
REACH = 1 << (DEPTH - 1)


@dataclass(frozen=True, eq=False)
class OctreeLeaves:
    """The leaves of an octree of depth 16, in Morton order.

    Attributes:
        voxel_size: edge length of a leaf at depth 16 [m].
        codes: (L,) int64, Morton code of the lowest voxel of each leaf, bits x, y, z from below, rising.
        depth: (L,) uint8; a leaf at depth d is a cube of 2^(16 - d) voxels.
        log_odds: (L,) float32.
        colours: (L, 3) uint8, or None.
    """

    voxel_size: float
    codes: np.ndarray
    depth: np.ndarray
    log_odds: np.ndarray
    colours: np.ndarray | None = None

    @property
    def voxels(self) -> int:
        """How many voxels all leaves make."""
        return int((1 << 3 * (DEPTH - self.depth.astype(np.int64))).sum())

    def pruned(self) -> "OctreeLeaves":
        """The same with every eight leaves of one node that agree in all joined, from the bottom up."""
        codes, depth, values = self.codes.copy(), self.depth.copy(), self.log_odds.copy()
        tint, first = np.zeros(len(codes), np.int32), np.arange(len(codes))
        if self.colours is not None:
            tint = self.colours.astype(np.int32) @ np.array([1, 1 << 8, 1 << 16], np.int32)
        count = _prune(codes, depth, values, tint, first)
        kept = None if self.colours is None else self.colours[first[:count]]
        return OctreeLeaves(self.voxel_size, codes[:count], depth[:count], values[:count], kept)

    def expanded(self) -> tuple[np.ndarray, np.ndarray]:
        """Indices (V, 3) int64 of all voxels, from -2^15, and which leaf each is of, (V,) int64."""
        counts = 1 << 3 * (DEPTH - self.depth.astype(np.int64))
        leaf = np.repeat(np.arange(len(counts)), counts)
        inside = np.arange(len(leaf)) - np.repeat(np.cumsum(counts) - counts, counts)
        return morton_indices(self.codes[leaf] + inside), leaf


def morton_codes(indices: np.ndarray) -> np.ndarray:
    """Morton codes (V,) int64 of voxel indices (V, 3), each from -2^15 to 2^15 - 1."""
    code = np.zeros(len(indices), np.int64)
    for axis in range(3):
        code |= _spread(np.asarray(indices[:, axis], np.int64) + REACH) << axis
    return code


def morton_indices(codes: np.ndarray) -> np.ndarray:
    """Voxel indices (V, 3) int64 of Morton codes (V,)."""
    return np.stack([_gather(codes >> axis) for axis in range(3)], axis=-1) - REACH


def _spread(x: np.ndarray) -> np.ndarray:
    """Puts two zeros between the 16 bits of x."""
    for shift, mask in ((16, 0x0000FF0000FF), (8, 0x00F00F00F00F), (4, 0x0C30C30C30C3), (2, 0x249249249249)):
        x = (x | x << shift) & mask
    return x


def _gather(x: np.ndarray) -> np.ndarray:
    """Takes every third bit of x."""
    x = x & 0x249249249249
    for shift, mask in ((2, 0x0C30C30C30C3), (4, 0x00F00F00F00F), (8, 0x0000FF0000FF), (16, 0xFFFF)):
        x = (x | x >> shift) & mask
    return x


@njit(cache=True)
def _prune(codes: np.ndarray, depth: np.ndarray, values: np.ndarray, tint: np.ndarray, first: np.ndarray) -> int:
    """Joins leaves in place, level by level; returns how many are left. `first` goes with the first of those joined."""
    count = len(codes)
    for level in range(DEPTH, 0, -1):
        width = 1 << 3 * (DEPTH - level)
        read, write = 0, 0
        while read < count:
            joins = depth[read] == level and codes[read] & (8 * width - 1) == 0 and read + 7 < count
            j = read + 1
            while joins and j < read + 8:
                joins = depth[j] == level and codes[j] == codes[read] + (j - read) * width
                joins = joins and values[j] == values[read] and tint[j] == tint[read]
                j += 1
            codes[write], values[write] = codes[read], values[read]
            tint[write], first[write] = tint[read], first[read]
            depth[write] = level - 1 if joins else depth[read]
            read += 8 if joins else 1
            write += 1
        count = write
    return count


@njit(cache=True, inline="always")
def _shared_levels(code: int, other: int) -> int:
    """Depth of the deepest node that holds both codes."""
    differ, levels = code ^ other, DEPTH
    while differ:
        differ >>= 3
        levels -= 1
    return levels


@njit(cache=True)
def encode_binary(codes: np.ndarray, depth: np.ndarray, occupied: np.ndarray) -> tuple[np.ndarray, int]:
    """Bytes of a `.bt` file's data, and the number of nodes.

    Two bytes an inner node, in depth-first order: two bits a child, 0 for none, 1 free, 2 occupied, 3 inner.
    """
    size, nodes = 0, 0
    data = np.zeros(2 * (1 + DEPTH * len(codes)), np.uint8)
    path = np.zeros(DEPTH, np.int64)  # where the node at each depth on the way to the leaf is in `data`
    for i in range(len(codes)):
        if i == 0:
            start, size, nodes = 0, 2, 1
        else:
            start = _shared_levels(codes[i], codes[i - 1])
        for d in range(start, depth[i]):
            child = (codes[i] >> 3 * (DEPTH - 1 - d)) & 7
            is_leaf = d == depth[i] - 1
            kind = (2 if occupied[i] else 1) if is_leaf else 3
            data[path[d] + child // 4] |= kind << 2 * (child % 4)
            nodes += 1
            if not is_leaf:
                path[d + 1] = size
                size += 2
    return data[:size].copy(), nodes


@njit(cache=True)
def encode_full(
    codes: np.ndarray, depth: np.ndarray, values: np.ndarray, colours: np.ndarray, with_colours: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes of an `.ot` file in depth-first order: values (N,) float32, colours (N, 3) and children (N,) uint8.

    An inner node has the highest value of those below it, and white for colour: OctoMap's sign for none.
    """
    nodes = 0
    most = 1 + DEPTH * len(codes)
    value = np.full(most, -np.inf, np.float32)
    colour = np.full((most, 3), 255, np.uint8)
    children = np.zeros(most, np.uint8)
    path = np.zeros(DEPTH + 1, np.int64)
    for i in range(len(codes)):
        if i == 0:
            start, nodes = 0, 1
        else:
            start = _shared_levels(codes[i], codes[i - 1])
        for d in range(start, depth[i]):
            children[path[d]] |= 1 << ((codes[i] >> 3 * (DEPTH - 1 - d)) & 7)
            path[d + 1] = nodes
            nodes += 1
        for d in range(depth[i] + 1):
            value[path[d]] = max(value[path[d]], values[i])
        if with_colours:
            colour[path[depth[i]]] = colours[i]
    return value[:nodes], colour[:nodes], children[:nodes]


@njit(cache=True)
def decode_binary(data: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, int, int]:
    """Leaves of a `.bt` file's data: codes, depths, occupied or not, number of nodes, and bytes that were read.

    The number of nodes is -1 if the data end too early, -2 if the tree is too deep.
    """
    most = 4 * len(data) + 1
    codes, depth = np.empty(most, np.int64), np.empty(most, np.uint8)
    occupied = np.empty(most, np.uint8)
    if len(data) < 2:
        return codes[:0], depth[:0], occupied[:0], -1, 0
    leaves, nodes, at = 0, 1, 2
    code, bits, child = np.zeros(DEPTH, np.int64), np.zeros(DEPTH, np.int64), np.zeros(DEPTH, np.int64)
    bits[0] = data[0] | np.int64(data[1]) << 8
    d = 0
    while d >= 0:
        if child[d] == 8:
            d -= 1
            continue
        kind = (bits[d] >> 2 * child[d]) & 3
        below = code[d] | child[d] << 3 * (DEPTH - 1 - d)
        child[d] += 1
        if kind == 0:
            continue
        nodes += 1
        if kind < 3:
            codes[leaves], depth[leaves], occupied[leaves] = below, d + 1, kind == 2
            leaves += 1
            continue
        if d + 1 == DEPTH:
            return codes[:0], depth[:0], occupied[:0], -2, at
        if at + 2 > len(data):
            return codes[:0], depth[:0], occupied[:0], -1, at
        d += 1
        code[d], child[d] = below, 0
        bits[d] = data[at] | np.int64(data[at + 1]) << 8
        at += 2
    return codes[:leaves], depth[:leaves], occupied[:leaves], nodes, at


@njit(cache=True)
def decode_full(children: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Leaves of an `.ot` file from the `children` (N,) of its nodes: codes, depths, which node each is, nodes read.

    Their number is -1 if the data end too early, -2 if the tree is too deep.
    """
    codes, depth = np.empty(len(children), np.int64), np.empty(len(children), np.uint8)
    node = np.empty(len(children), np.int64)
    code, child = np.zeros(DEPTH + 1, np.int64), np.zeros(DEPTH + 1, np.int64)
    bits = np.zeros(DEPTH + 1, np.uint8)
    leaves, at, d = 0, 0, 0
    while True:
        # Reads node number `at`, which is at depth d.
        if at == len(children):
            return codes[:0], depth[:0], node[:0], -1
        bits[d], child[d] = children[at], 0
        if bits[d] == 0:
            codes[leaves], depth[leaves], node[leaves] = code[d], d, at
            leaves += 1
        elif d == DEPTH:
            return codes[:0], depth[:0], node[:0], -2
        at += 1
        # Goes on to the next child that there is.
        while d >= 0 and bits[d] >> child[d] == 0:
            d -= 1
        if d < 0:
            return codes[:leaves], depth[:leaves], node[:leaves], at
        while (bits[d] >> child[d]) & 1 == 0:
            child[d] += 1
        code[d + 1] = code[d] | child[d] << 3 * (DEPTH - 1 - d)
        child[d] += 1
        d += 1
