"""Which voxels the rays of one scan pass through and end in: exact traversal of a grid, without any map.

Voxels are kept in blocks of `BLOCK`³. A block's key packs its three indices in 63 bits, so that a grid reaches 2^20
blocks to every side; a voxel's place inside is (i·BLOCK + j)·BLOCK + k.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

BLOCK = 8
VOXELS = BLOCK**3
_BITS = 21
HALF = 1 << (_BITS - 1)
_STEP_X, _STEP_Y = 1 << 2 * _BITS, 1 << _BITS
# Multiplier of Fibonacci hashing: 2^64 / golden ratio, as int64.
_FIBONACCI = -7046029254386353131

# What a scan says about a voxel.
UNSEEN, PASSED, HIT = 0, 1, 2


@dataclass(frozen=True, eq=False)
class CarvedScan:
    """What one scan says about the voxels around it.

    Attributes:
        keys: the blocks that it touched, (B,) int64, in the order in which the rays met them.
        marks: (B, 512) uint8, `UNSEEN`, `PASSED` or `HIT`.
        target: block (row of `keys`) · 512 + place of the voxel of each point, (N,) int64; -1 for points that hit none.
    """

    keys: np.ndarray
    marks: np.ndarray
    target: np.ndarray


def pack_blocks(blocks: np.ndarray) -> np.ndarray:
    """Keys (B,) int64 of block indices (B, 3), each within ±`HALF`."""
    moved = np.asarray(blocks, np.int64) + HALF
    return (moved[:, 0] << 2 * _BITS) | (moved[:, 1] << _BITS) | moved[:, 2]


def unpack_blocks(keys: np.ndarray) -> np.ndarray:
    """Block indices (B, 3) int64 of keys (B,)."""
    mask = (1 << _BITS) - 1
    return np.stack([keys >> 2 * _BITS, (keys >> _BITS) & mask, keys & mask], axis=-1) - HALF


def locate(points: np.ndarray, voxel: float) -> tuple[np.ndarray, np.ndarray]:
    """Key of the block, (N,) int64, and place in it, (N,) int64, of each point (N, 3); key -1 outside the grid."""
    cells = np.floor(np.asarray(points, float) * (1.0 / voxel))
    with np.errstate(invalid="ignore"):
        inside = (np.abs(cells) < HALF * BLOCK - 1).all(axis=1)  # False for NaN
    keys, place = split_indices(np.where(inside[:, None], cells, 0.0).astype(np.int64))
    return np.where(inside, keys, -1), place


def split_indices(indices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Key of the block, (N,) int64, and place in it, (N,) int64, of voxel `indices` (N, 3) int64 inside the grid."""
    inner = indices % BLOCK
    return pack_blocks(indices // BLOCK), (inner[:, 0] * BLOCK + inner[:, 1]) * BLOCK + inner[:, 2]


@njit(cache=True, inline="always")
def table_position(table: np.ndarray, key: int) -> int:
    """Row of an open-addressing `table` (2^n, 2) of (key, value) where `key` is, or where it would be put."""
    mask = len(table) - 1
    mixed = key * _FIBONACCI
    at = (mixed ^ (mixed >> 32)) & mask
    while table[at, 0] != key and table[at, 0] != -1:
        at = (at + 1) & mask
    return at


def empty_table(entries: int) -> np.ndarray:
    """A table for `table_position` that is at most half full with `entries`."""
    return np.full((1 << max(4, int(2 * entries - 1).bit_length()), 2), -1, np.int64)


def carve(
    points: np.ndarray,
    origin: np.ndarray,
    voxel: float,
    max_range: float,
    rays: np.ndarray | None = None,
    expected_blocks: int = 1024,
) -> CarvedScan:
    """Follows the ray from `origin` to each point through a grid of voxels with edge `voxel` [m].

    The traversal is exact (Amanatides and Woo, "A fast voxel traversal algorithm for ray tracing", 1987): every voxel
    whose inside the ray crosses is passed, that of the origin too, that of the point not. Where a ray goes exactly
    through an edge or a corner it steps along z first, then y, then x, and so passes one of the voxels that touch
    there. As in OctoMap (Hornung et al. 2013, section 5.1) a voxel is marked once a scan, and a hit wins over rays that
    pass. A point beyond `max_range` hits nothing; its ray passes up to there.

    Args:
        points: (N, 3) [m], float32 or float64; those that are not finite or outside the grid are left out.
        origin: where the rays start, (3,) [m].
        max_range: [m]
        rays: (N,) bool, which points have a ray from `origin`; the others only hit. All when not given.
        expected_blocks: of how many touched blocks to think first; more only costs a second try.

    Raises:
        ValueError: `origin` is not finite or outside the grid, or a shape is wrong.
    """
    points = np.ascontiguousarray(points, np.float64)
    origin = np.ascontiguousarray(origin, np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or origin.shape != (3,):
        raise ValueError(f"points {points.shape} and origin {origin.shape} are not (N, 3) and (3,)")
    if not (np.abs(origin) < (HALF - 1) * BLOCK * voxel).all():
        raise ValueError(f"origin {origin} is not finite or farther than 2^20 blocks from zero")
    carves = np.ones(len(points), np.uint8) if rays is None else np.ascontiguousarray(rays, np.uint8)
    if carves.shape != (len(points),):
        raise ValueError(f"rays {carves.shape} is not ({len(points)},)")
    target = np.empty(len(points), np.int64)
    capacity = max(16, expected_blocks)
    while True:
        keys = np.empty(capacity, np.int64)
        marks = np.zeros((capacity, VOXELS), np.uint8)
        count = _carve(
            points, origin, carves, 1.0 / voxel, max_range, empty_table(capacity), keys, marks.reshape(-1), target
        )
        if count >= 0:
            return CarvedScan(keys[:count], marks[:count], target)
        capacity *= 2


@njit(cache=True)
def _carve(
    points: np.ndarray,
    origin: np.ndarray,
    carves: np.ndarray,
    per_metre: float,
    max_range: float,
    table: np.ndarray,
    keys: np.ndarray,
    marks: np.ndarray,
    target: np.ndarray,
) -> int:
    """Fills `table`, `keys`, flat `marks` and `target`; returns the number of blocks, -1 if they do not fit."""
    limit = HALF * BLOCK - 1.0
    ox, oy, oz = origin[0] * per_metre, origin[1] * per_metre, origin[2] * per_metre
    start_x, start_y, start_z = int(np.floor(ox)), int(np.floor(oy)), int(np.floor(oz))
    count = 0
    start_key = _key(start_x, start_y, start_z)
    for i in range(len(points)):
        if carves[i] == 0:
            continue
        px, py, pz = points[i, 0] * per_metre, points[i, 1] * per_metre, points[i, 2] * per_metre
        if not (abs(px) < limit and abs(py) < limit and abs(pz) < limit):  # False for NaN
            continue
        dx, dy, dz = px - ox, py - oy, pz - oz
        reach = np.sqrt(dx * dx + dy * dy + dz * dz)
        if reach > max_range * per_metre:
            shrink = max_range * per_metre / reach
            dx, dy, dz = dx * shrink, dy * shrink, dz * shrink
            px, py, pz = ox + dx, oy + dy, oz + dz
        x_steps, dir_x, next_x, share_x, last_x = _axis(ox, px, dx)
        y_steps, dir_y, next_y, share_y, last_y = _axis(oy, py, dy)
        z_steps, dir_z, next_z, share_z, last_z = _axis(oz, pz, dz)
        in_x, in_y, in_z = start_x & (BLOCK - 1), start_y & (BLOCK - 1), start_z & (BLOCK - 1)
        key, row = start_key, -1
        for _ in range(x_steps + y_steps + z_steps):
            if row < 0:
                row = _row(table, keys, count, key)
                if row < 0:
                    return -1
                count = max(count, row + 1)
            marks[row * VOXELS + ((in_x * BLOCK + in_y) * BLOCK + in_z)] = PASSED
            # Without branches, which no processor could foretell.
            along_x = (next_x < next_y) & (next_x < next_z)
            along_y = (next_y < next_z) & (not along_x)
            along_z = not (along_x | along_y)
            next_x = (next_x + share_x if next_x < last_x else np.inf) if along_x else next_x
            next_y = (next_y + share_y if next_y < last_y else np.inf) if along_y else next_y
            next_z = (next_z + share_z if next_z < last_z else np.inf) if along_z else next_z
            in_x += dir_x if along_x else 0
            in_y += dir_y if along_y else 0
            in_z += dir_z if along_z else 0
            if (in_x | in_y | in_z) & BLOCK:  # one of them is 8 or -1
                key += dir_x * _STEP_X if along_x else dir_y * _STEP_Y if along_y else dir_z
                in_x, in_y, in_z = in_x & (BLOCK - 1), in_y & (BLOCK - 1), in_z & (BLOCK - 1)
                row = -1
    for i in range(len(points)):
        px, py, pz = points[i, 0] * per_metre, points[i, 1] * per_metre, points[i, 2] * per_metre
        target[i] = -1
        if not (abs(px) < limit and abs(py) < limit and abs(pz) < limit):
            continue
        reach = np.sqrt((px - ox) ** 2 + (py - oy) ** 2 + (pz - oz) ** 2)
        if reach > max_range * per_metre:
            continue
        x, y, z = int(np.floor(px)), int(np.floor(py)), int(np.floor(pz))
        key = _key(x, y, z)
        row = _row(table, keys, count, key)
        if row < 0:
            return -1
        count = max(count, row + 1)
        target[i] = row * VOXELS + (((x & (BLOCK - 1)) * BLOCK + (y & (BLOCK - 1))) * BLOCK + (z & (BLOCK - 1)))
        marks[target[i]] = HIT
    return count


@njit(cache=True, inline="always")
def _axis(start: float, end: float, along: float) -> tuple[int, int, float, float, float]:
    """Traversal along one axis, all in units of voxels and shares of the ray.

    Returns:
        Steps to go, their direction, the share at the next border, that between borders, and a share between those of
        the last two borders: an axis that has arrived is never stepped again, whatever is rounded.
    """
    first, last = np.floor(start), np.floor(end)
    if last == first:
        return 0, 0, np.inf, np.inf, -np.inf
    share = 1.0 / abs(along)
    to_border = (first + (1.0 if last > first else 0.0) - start) / along
    steps = abs(last - first)
    return int(steps), (1 if last > first else -1), to_border, share, to_border + (steps - 1.5) * share


@njit(cache=True, inline="always")
def _row(table: np.ndarray, keys: np.ndarray, count: int, key: int) -> int:
    """Row of the block `key`, `count` if it is new; -1 if there is no room for it."""
    at = table_position(table, key)
    if table[at, 0] == -1:
        if count == len(keys):
            return -1
        table[at, 0], table[at, 1], keys[count] = key, count, key
    return table[at, 1]


@njit(cache=True, inline="always")
def _key(x: int, y: int, z: int) -> int:
    """Key of the block of a voxel; BLOCK is 2^3."""
    return (((x >> 3) + HALF) << 2 * _BITS) | (((y >> 3) + HALF) << _BITS) | ((z >> 3) + HALF)
