"""Where a voxel map keeps its blocks: chunks found by a hash, shared between copies until one of them writes.

A chunk holds `CHUNK` blocks; a new one is added when all are full, so nothing is moved when a map grows (only the
table of 16 bytes an entry is rehashed). A copy shares every chunk; whoever writes into a shared one copies it first.

Each voxel has its log-odds (float32, NaN while unknown) and the number of its record in the chunk (uint16). Records
are only of occupied voxels: class counts, and running means of channels with their weights.
"""

from collections.abc import Iterator

import numpy as np
from numba import njit

from .carving import HIT, UNSEEN, VOXELS, empty_table, table_position

CHUNK = 64
NO_RECORD = np.iinfo(np.uint16).max
# Class counts are kept in steps of 1 / OBSERVATION of one observation; when one would overflow, all are halved.
OBSERVATION = 64
_FULL = np.iinfo(np.uint16).max


class Chunk:
    """Arrays of `CHUNK` blocks: `log_odds`, `record` (CHUNK · 512,); `counts` (R, K), `means`, `weights` (R, C)."""

    def __init__(self, classes: int, channels: int):
        self.owner: object = None
        self.log_odds = np.full(CHUNK * VOXELS, np.nan, np.float32)
        self.record = np.full(CHUNK * VOXELS, NO_RECORD, np.uint16)
        self.counts = np.zeros((0, classes), np.uint16)
        self.means = np.zeros((0, channels), np.float32)
        self.weights = np.zeros((0, channels), np.uint16)
        self.used = 0

    def copy(self) -> "Chunk":
        other = Chunk.__new__(Chunk)
        other.owner, other.used = None, self.used
        for name in ("log_odds", "record", "counts", "means", "weights"):
            setattr(other, name, getattr(self, name).copy())
        return other

    def make_room(self, records: int) -> None:
        """Room for `records` in all, and a quarter more if there is not."""
        if records > len(self.counts):
            for name in ("counts", "means", "weights"):
                old = getattr(self, name)
                new = np.zeros((min(records + records // 4 + 16, CHUNK * VOXELS), old.shape[1]), old.dtype)
                new[: self.used] = old[: self.used]
                setattr(self, name, new)

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays, used or not."""
        arrays = (self.log_odds, self.record, self.counts, self.means, self.weights)
        return sum(array.nbytes for array in arrays)


class BlockStore:
    """Blocks by key, in slots that are numbered as they come: slot s is block s % CHUNK of chunk s // CHUNK."""

    def __init__(self, classes: int, channels: int):
        self.classes, self.channels = classes, channels
        self.count = 0
        self.chunks: list[Chunk] = []
        self._keys = np.empty(64, np.int64)
        self._table = empty_table(64)
        self._owner = object()
        self._table_is_shared = False

    @property
    def keys(self) -> np.ndarray:
        """Key of each slot, (count,) int64."""
        return self._keys[: self.count]

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays, with the room that is not used yet; what copies share is counted in full."""
        return sum(chunk.nbytes for chunk in self.chunks) + self._keys.nbytes + self._table.nbytes

    def copy(self) -> "BlockStore":
        """A store of the same content. Costs a pointer a chunk; from now on both copy what they write to."""
        other = BlockStore.__new__(BlockStore)
        other.__dict__.update(self.__dict__)
        other.chunks = list(self.chunks)
        self._owner, other._owner = object(), object()
        self._table_is_shared = other._table_is_shared = True
        return other

    def find(self, keys: np.ndarray) -> np.ndarray:
        """Slot of each key, (N,) int64; -1 where there is no such block."""
        return _find(self._table, np.ascontiguousarray(keys, np.int64))

    def find_or_add(self, keys: np.ndarray) -> np.ndarray:
        """Slot of each of `keys` (N,), which are all different; new blocks are unknown all over."""
        slots = self.find(keys)
        new = np.flatnonzero(slots < 0)
        if len(new) == 0:
            return slots
        if self._table_is_shared:
            self._table, self._keys, self._table_is_shared = self._table.copy(), self._keys.copy(), False
        total = self.count + len(new)
        if total > len(self._keys):
            self._keys = np.concatenate([self.keys, np.empty(max(total, 2 * self.count) - self.count, np.int64)])
        slots[new] = np.arange(self.count, total)
        self._keys[self.count : total] = keys[new]
        if 2 * total > len(self._table):
            self._table = empty_table(2 * total)
            _add(self._table, self._keys[:total], 0)
        else:
            _add(self._table, self._keys[self.count : total], self.count)
        self.count = total
        while len(self.chunks) * CHUNK < total:
            self.chunks.append(Chunk(self.classes, self.channels))
            self.chunks[-1].owner = self._owner
        return slots

    def writable(self, index: int) -> Chunk:
        """Chunk number `index`, to write to."""
        chunk = self.chunks[index]
        if chunk.owner is not self._owner:
            chunk = self.chunks[index] = chunk.copy()
            chunk.owner = self._owner
        return chunk

    def set_classes(self, classes: int) -> None:
        """Gives records counts of `classes` classes; before there were none."""
        self.classes = classes
        for index in range(len(self.chunks)):
            chunk = self.writable(index)
            chunk.counts = np.zeros((len(chunk.counts), classes), np.uint16)


def by_chunk(slots: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """Number of each chunk that holds some of `slots` (N,), and which of them, in their order; -1 is left out."""
    chunks = slots // CHUNK
    order = np.argsort(chunks.astype(np.int32), kind="stable")
    numbers, starts = np.unique(chunks[order], return_index=True)
    for number, which in zip(numbers, np.split(order, starts[1:]), strict=False):  # of nothing, split makes one part
        if number >= 0:
            yield int(number), which


@njit(cache=True)
def _find(table: np.ndarray, keys: np.ndarray) -> np.ndarray:
    slots = np.empty(len(keys), np.int64)
    for i in range(len(keys)):
        # An unused row has value -1, and so has what is looked for with key -1.
        slots[i] = table[table_position(table, keys[i]), 1]
    return slots


@njit(cache=True)
def _add(table: np.ndarray, keys: np.ndarray, first: int) -> None:
    for i in range(len(keys)):
        at = table_position(table, keys[i])
        table[at, 0], table[at, 1] = keys[i], first + i


@njit(cache=True)
def update_blocks(
    log_odds: np.ndarray,
    record: np.ndarray,
    counts: np.ndarray,
    weights: np.ndarray,
    blocks: np.ndarray,
    marks: np.ndarray,
    rows: np.ndarray,
    steps: np.ndarray,
) -> None:
    """Adds a scan's `marks[rows]` to `blocks` of a chunk; `steps` are the log-odds (hit, miss, lowest, highest).

    A voxel that is no longer occupied forgets what it was.
    """
    hit, miss, low, high = steps
    for i in range(len(blocks)):
        base, seen = blocks[i] * VOXELS, marks[rows[i]]
        for j in range(VOXELS):
            if seen[j] != UNSEEN:
                old = log_odds[base + j]
                new = (old if old == old else np.float32(0.0)) + (hit if seen[j] == HIT else miss)
                log_odds[base + j] = min(max(new, low), high)
                if new < 0 and record[base + j] != NO_RECORD:
                    counts[record[base + j]] = 0
                    weights[record[base + j]] = 0


@njit(cache=True)
def assign_records(log_odds: np.ndarray, record: np.ndarray, used: int, voxels: np.ndarray) -> int:
    """Gives every occupied one of `voxels` (N,) of a chunk a record; returns how many there are now."""
    for v in voxels:
        if log_odds[v] >= 0 and record[v] == NO_RECORD:
            record[v] = used
            used += 1
    return used


@njit(cache=True)
def add_observations(
    record: np.ndarray,
    log_odds: np.ndarray,
    counts: np.ndarray,
    means: np.ndarray,
    weights: np.ndarray,
    voxels: np.ndarray,
    classes: np.ndarray,
    channels: np.ndarray,
    numbers: np.ndarray,
) -> None:
    """Adds observations to the records of occupied voxels of a chunk.

    Args:
        voxels: (N,) places in the chunk.
        classes: (N, K) observations of each class; a row with NaN says nothing.
        channels: (N, C) values; NaN says nothing.
        numbers: (N, C) of how many measurements each value is the mean.
    """
    for i in range(len(voxels)):
        r = record[voxels[i]]
        if r == NO_RECORD or not log_odds[voxels[i]] >= 0:
            continue
        if np.isfinite(classes[i].sum()):
            top = 0.0
            for k in range(classes.shape[1]):
                top = max(top, counts[r, k] + OBSERVATION * classes[i, k])
            scale = 1.0
            while top * scale > _FULL:
                scale *= 0.5
            for k in range(classes.shape[1]):
                counts[r, k] = np.uint16((counts[r, k] + OBSERVATION * classes[i, k]) * scale + 0.5)
        for c in range(channels.shape[1]):
            number = numbers[i, c]
            if np.isfinite(channels[i, c]) and number >= 1:
                weight = min(weights[r, c] + number, float(_FULL))
                means[r, c] += (channels[i, c] - means[r, c]) * min(1.0, number / weight)
                weights[r, c] = np.uint16(weight)
