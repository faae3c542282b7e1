"""Adding one map of voxels to another, also moved: how sub-maps become one map."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from .block_store import CHUNK, NO_RECORD, OBSERVATION, BlockStore, add_observations, assign_records, by_chunk
from .carving import BLOCK, HALF, VOXELS, empty_table, pack_blocks, table_position, unpack_blocks

# A motion smaller than this, in metres and as sine, is none.
_STILL = 1e-9


@dataclass(frozen=True, eq=False)
class Blocks:
    """Blocks of voxels to be added to a map.

    Attributes:
        keys: (B,) int64.
        log_odds: (B, 512) float32, NaN where unknown.
        record: (B, 512) int32, row of the following for each voxel, -1 where it has none.
        observed: (R, K) float64, observations of each class.
        means, weights: (R, C) float64, of the channels; NaN and 0 where there is none.
    """

    keys: np.ndarray
    log_odds: np.ndarray
    record: np.ndarray
    observed: np.ndarray
    means: np.ndarray
    weights: np.ndarray


def all_blocks(store: BlockStore) -> Blocks:
    """Everything that `store` holds, in the order of its slots."""
    chunks, count = store.chunks, store.count * VOXELS
    first = np.cumsum([0] + [chunk.used for chunk in chunks])
    record = [
        np.where(c.record == NO_RECORD, -1, c.record.astype(np.int32) + f) for c, f in zip(chunks, first, strict=False)
    ]
    weights = _stacked([c.weights[: c.used] for c in chunks], store.channels)
    means = _stacked([c.means[: c.used] for c in chunks], store.channels)
    return Blocks(
        store.keys.copy(),
        np.concatenate([np.zeros(0, np.float32), *(c.log_odds for c in chunks)])[:count].reshape(-1, VOXELS),
        np.concatenate([np.zeros(0, np.int32), *record])[:count].reshape(-1, VOXELS).astype(np.int32),
        _stacked([c.counts[: c.used] for c in chunks], store.classes) / OBSERVATION,
        np.where(weights > 0, means, np.nan),
        weights,
    )


def _stacked(parts: list[np.ndarray], width: int) -> np.ndarray:
    return np.concatenate([np.zeros((0, width)), *parts]).astype(float)


def is_still(X: np.ndarray) -> bool:
    """Whether the pose X (4, 4) moves nothing."""
    return bool(np.abs(X - np.eye(4)).max() < _STILL)


def move_blocks(blocks: Blocks, X: np.ndarray, voxel: float) -> Blocks:
    """`blocks` taken through the pose X (4, 4) [m] onto the grid of voxels with edge `voxel` [m].

    Every voxel of the new grid takes over what is in the old one at its centre, so that free space keeps no holes. In a
    turned grid no centre may fall into an old voxel; an occupied one of this kind is put where its own centre arrives.
    So nothing occupied is lost, and since a voxel's centre is within √3/2 voxels of all of it, what is taken over is
    at most √3 voxels from where its points are now: their own voxel is at most two away along each axis.
    """
    X_cells = X.copy()
    X_cells[:3, 3] /= voxel
    candidates = _blocks_reached(unpack_blocks(blocks.keys), X_cells)
    source = _table_of(blocks.keys)
    target = _table_of(candidates)
    log_odds = np.full((len(candidates), VOXELS), np.nan, np.float32)
    record = np.full((len(candidates), VOXELS), -1, np.int32)
    taken = np.zeros(blocks.log_odds.shape, np.uint8)
    _pull(candidates, log_odds, record, source, blocks.log_odds, blocks.record, taken, np.linalg.inv(X_cells))
    _push_missed(blocks.keys, blocks.log_odds, blocks.record, taken, target, log_odds, record, X_cells)
    kept = np.isfinite(log_odds).any(axis=1)
    return Blocks(candidates[kept], log_odds[kept], record[kept], blocks.observed, blocks.means, blocks.weights)


def add_blocks(store: BlockStore, blocks: Blocks, low: float, high: float) -> None:
    """Adds log-odds, clamped to [`low`, `high`], class observations and means to `store`."""
    slots = store.find_or_add(blocks.keys)
    for number, rows in by_chunk(slots):
        chunk = store.writable(number)
        places = slots[rows] % CHUNK
        _add_log_odds(
            chunk.log_odds, chunk.record, chunk.counts, chunk.weights, places, blocks.log_odds, rows, low, high
        )
        row, place = np.nonzero(blocks.record[rows] >= 0)
        if len(row) == 0:
            continue
        voxels, of = places[row] * VOXELS + place, blocks.record[rows[row], place]
        used = assign_records(chunk.log_odds, chunk.record, chunk.used, voxels)
        chunk.make_room(used)
        chunk.used = used
        add_observations(
            chunk.record,
            chunk.log_odds,
            chunk.counts,
            chunk.means,
            chunk.weights,
            voxels,
            blocks.observed[of],
            blocks.means[of],
            blocks.weights[of],
        )


def _table_of(keys: np.ndarray) -> np.ndarray:
    table = empty_table(len(keys))
    _fill(table, keys)
    return table


def _blocks_reached(blocks: np.ndarray, X_cells: np.ndarray) -> np.ndarray:
    """Sorted keys of all blocks that the moved `blocks` (B, 3) can touch, with a margin of one voxel."""
    centre = (blocks + 0.5) * BLOCK @ X_cells[:3, :3].T + X_cells[:3, 3]
    half = np.abs(X_cells[:3, :3]).sum(axis=1) * BLOCK / 2 + 1
    first = np.floor((centre - half) / BLOCK).astype(np.int64)
    last = np.floor((centre + half) / BLOCK).astype(np.int64)
    most = int((last - first).max(initial=0)) + 1
    keys = []
    for offset in np.ndindex(most, most, most):
        reached = first + offset
        keys.append(pack_blocks(reached[((reached <= last) & (np.abs(reached) < HALF)).all(axis=1)]))
    return np.unique(np.concatenate(keys))


@njit(cache=True)
def _fill(table: np.ndarray, keys: np.ndarray) -> None:
    for i in range(len(keys)):
        at = table_position(table, keys[i])
        table[at, 0], table[at, 1] = keys[i], i


@njit(cache=True, inline="always")
def _cell(x: float, y: float, z: float, X: np.ndarray) -> tuple[int, int]:
    """Key of the block and place in it of the moved point (in voxels); -1 outside the grid."""
    i = int(np.floor(X[0, 0] * x + X[0, 1] * y + X[0, 2] * z + X[0, 3]))
    j = int(np.floor(X[1, 0] * x + X[1, 1] * y + X[1, 2] * z + X[1, 3]))
    k = int(np.floor(X[2, 0] * x + X[2, 1] * y + X[2, 2] * z + X[2, 3]))
    if max(abs(i), abs(j), abs(k)) >= HALF * BLOCK - BLOCK:
        return -2, 0
    key = (((i >> 3) + HALF) << 42) | (((j >> 3) + HALF) << 21) | ((k >> 3) + HALF)
    return key, ((i & 7) * BLOCK + (j & 7)) * BLOCK + (k & 7)


@njit(cache=True)
def _pull(
    keys: np.ndarray,
    log_odds: np.ndarray,
    record: np.ndarray,
    table: np.ndarray,
    from_log_odds: np.ndarray,
    from_record: np.ndarray,
    taken: np.ndarray,
    X: np.ndarray,
) -> None:
    """Fills every voxel of the blocks `keys` with what is at its centre, moved by X (4, 4), in the source."""
    mask = (1 << 21) - 1
    for b in range(len(keys)):
        x0 = ((keys[b] >> 42) - HALF) * BLOCK + 0.5
        y0 = (((keys[b] >> 21) & mask) - HALF) * BLOCK + 0.5
        z0 = ((keys[b] & mask) - HALF) * BLOCK + 0.5
        last_key, row = -3, -1
        for v in range(VOXELS):
            key, place = _cell(x0 + (v >> 6), y0 + ((v >> 3) & 7), z0 + (v & 7), X)
            if key != last_key:
                row, last_key = table[table_position(table, key), 1], key
            if row >= 0:
                log_odds[b, v] = from_log_odds[row, place]
                record[b, v] = from_record[row, place]
                taken[row, place] = 1


@njit(cache=True)
def _push_missed(
    keys: np.ndarray,
    from_log_odds: np.ndarray,
    from_record: np.ndarray,
    taken: np.ndarray,
    table: np.ndarray,
    log_odds: np.ndarray,
    record: np.ndarray,
    X: np.ndarray,
) -> None:
    mask = (1 << 21) - 1
    for b in range(len(keys)):
        x0 = ((keys[b] >> 42) - HALF) * BLOCK + 0.5
        y0 = (((keys[b] >> 21) & mask) - HALF) * BLOCK + 0.5
        z0 = ((keys[b] & mask) - HALF) * BLOCK + 0.5
        for v in range(VOXELS):
            if from_log_odds[b, v] >= 0 and taken[b, v] == 0:
                key, place = _cell(x0 + (v >> 6), y0 + ((v >> 3) & 7), z0 + (v & 7), X)
                row = table[table_position(table, key), 1]
                if row >= 0 and not log_odds[row, place] >= 0:
                    log_odds[row, place] = from_log_odds[b, v]
                    record[row, place] = from_record[b, v]


@njit(cache=True)
def _add_log_odds(
    log_odds: np.ndarray,
    record: np.ndarray,
    counts: np.ndarray,
    weights: np.ndarray,
    blocks: np.ndarray,
    added: np.ndarray,
    rows: np.ndarray,
    low: float,
    high: float,
) -> None:
    for i in range(len(blocks)):
        base = blocks[i] * VOXELS
        for j in range(VOXELS):
            more = added[rows[i], j]
            if more == more:
                old = log_odds[base + j]
                new = min(max((old if old == old else np.float32(0.0)) + more, low), high)
                log_odds[base + j] = new
                if new < 0 and record[base + j] != NO_RECORD:
                    counts[record[base + j]] = 0
                    weights[record[base + j]] = 0
