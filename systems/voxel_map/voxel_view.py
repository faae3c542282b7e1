"""What can be asked of a map of voxels."""

from collections.abc import Iterator, Sequence

import numpy as np
import open3d as o3d
from open3d.t.geometry import PointCloud

from .block_store import CHUNK, NO_RECORD, OBSERVATION, BlockStore, Chunk, by_chunk
from .carving import BLOCK, VOXELS, locate, unpack_blocks
from .dense_voxels import NO_LABEL, DenseVoxels, dense_shape, voxel_state
from .voxel_map_config import VoxelMapConfig


class VoxelView:
    """Read-only side of `VoxelMap`: occupancy, classes and channels at points, of all voxels, or of a box of them."""

    def __init__(self, config: VoxelMapConfig, channels: Sequence[str], store: BlockStore):
        self.config = config
        self.channels = tuple(channels)
        self._store = store

    def __repr__(self) -> str:
        _, log_odds = self.known()
        occupied, total = int((log_odds >= 0).sum()), float(log_odds.sum(dtype=float))
        return f"{type(self).__name__}({len(log_odds)} voxels known, {occupied} occupied, sum of log-odds {total:.9g})"

    @property
    def voxel_size(self) -> float:
        """[m]"""
        return self.config.voxel_size

    @property
    def classes(self) -> int:
        """K, 0 as long as no scan had classes."""
        return self._store.classes

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays of the map, with spare room; what copies share is counted in each of them."""
        return self._store.nbytes

    def log_odds(self, p_MP: np.ndarray) -> np.ndarray:
        """Log-odds of occupancy at points (N, 3) [m], (N,) float32; NaN where unknown."""
        found = np.full(len(p_MP), np.nan, np.float32)
        for chunk, which, voxels in self._at(p_MP):
            found[which] = chunk.log_odds[voxels]
        return found

    def occupancy(self, p_MP: np.ndarray) -> np.ndarray:
        """Probability of occupancy at points (N, 3) [m], (N,) float32; 0.5 where unknown."""
        return _probability(np.nan_to_num(self.log_odds(p_MP), nan=0.0))

    def state(self, p_MP: np.ndarray) -> np.ndarray:
        """`UNKNOWN`, `FREE` or `OCCUPIED` at points (N, 3) [m], (N,) int8."""
        return voxel_state(self.log_odds(p_MP))

    def class_posterior(self, p_MP: np.ndarray) -> np.ndarray:
        """Probability of each class at points (N, 3) [m], (N, K) float32; even where nothing is known of it."""
        posterior = np.full((len(p_MP), self.classes), 1.0 / max(self.classes, 1), np.float32)
        for chunk, which, voxels in self._at(p_MP):
            posterior[which] = self._posterior(chunk, voxels)
        return posterior

    def class_entropy(self, p_MP: np.ndarray) -> np.ndarray:
        """Entropy of `class_posterior` at points (N, 3), (N,) float32 [nat]: log K where nothing is known."""
        posterior = self.class_posterior(p_MP)
        return -(posterior * np.log(np.maximum(posterior, 1e-30))).sum(axis=1)

    def known(self) -> tuple[np.ndarray, np.ndarray]:
        """Indices (V, 3) int64 and log-odds (V,) float32 of all known voxels, in the order of their blocks' arrival."""
        log_odds = self._log_odds_by_slot()
        at = np.flatnonzero(np.isfinite(log_odds))
        return self._indices(at), log_odds[at]

    def blocks(self) -> tuple[np.ndarray, np.ndarray]:
        """Indices (B, 3) int64 of all blocks of `BLOCK`³ voxels, and their log-odds (B, 512) float32, x outermost."""
        log_odds = self._log_odds_by_slot()[: len(self._store.keys) * VOXELS]
        return unpack_blocks(self._store.keys), log_odds.reshape(-1, VOXELS)

    def occupied(self) -> np.ndarray:
        """Centres of the occupied voxels, (V, 3) [m]."""
        return (self._indices(np.flatnonzero(self._log_odds_by_slot() >= 0)) + 0.5) * self.voxel_size

    def bounds(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Lowest and highest corner [m] of the box around all known voxels; None when there are none."""
        indices, _ = self.known()
        if len(indices) == 0:
            return None
        return indices.min(axis=0) * self.voxel_size, (indices.max(axis=0) + 1) * self.voxel_size

    def reach(self) -> tuple[np.ndarray, np.ndarray] | None:
        """As `bounds`, but of whole blocks, so up to 7 voxels larger, and quick."""
        blocks = unpack_blocks(self._store.keys)
        if len(blocks) == 0:
            return None
        edge = BLOCK * self.voxel_size
        return blocks.min(axis=0) * edge, (blocks.max(axis=0) + 1) * edge

    def to_cloud(self) -> PointCloud:
        """The centres of the occupied voxels, sorted by index.

        With `occupancy` (probability), float32; where there are classes `class_probabilities` (V, K) float32 and
        `label` uint8, the most probable; and each channel that some voxel has, float32, NaN where it is not known.
        """
        at = np.flatnonzero(self._log_odds_by_slot() >= 0)
        indices = self._indices(at)
        order = np.lexsort(indices.T[::-1])
        at, indices = at[order], indices[order]
        columns: dict[str, np.ndarray] = {}
        occupancy = np.zeros(len(at), np.float32)
        posterior = np.zeros((len(at), self.classes), np.float32)
        means = np.full((len(at), len(self.channels)), np.nan, np.float32)
        for number, which in by_chunk(at // VOXELS):
            chunk, voxels = self._store.chunks[number], at[which] - number * CHUNK * VOXELS
            occupancy[which] = _probability(chunk.log_odds[voxels])
            posterior[which] = self._posterior(chunk, voxels)
            means[which] = _means(chunk, voxels)
        columns["occupancy"] = occupancy[:, None]
        if self.classes:
            columns["class_probabilities"] = posterior
            columns["label"] = np.argmax(posterior, axis=1).astype(np.uint8)[:, None]
        for i, name in enumerate(self.channels):
            if np.isfinite(means[:, i]).any():
                columns[name] = means[:, i : i + 1]
        cloud = PointCloud(o3d.core.Tensor(((indices + 0.5) * self.voxel_size).astype(np.float32)))
        for name, column in columns.items():
            cloud.point[name] = o3d.core.Tensor(np.ascontiguousarray(column))
        return cloud

    def to_dense(self, low: np.ndarray, high: np.ndarray) -> DenseVoxels:
        """The voxels of a box as arrays, for planning: every voxel that `low` (3,) to `high` (3,) [m] touches.

        Raises:
            ValueError: the box is empty, not finite, or has more than 2^30 voxels.
        """
        first, shape = dense_shape(low, high, self.voxel_size)
        first_block, last_block = first // BLOCK, (first + shape - 1) // BLOCK
        blocks = unpack_blocks(self._store.keys)
        slots = np.flatnonzero(((blocks >= first_block) & (blocks <= last_block)).all(axis=1))
        extent = tuple(last_block - first_block + 1)
        log_odds = np.full((*extent, VOXELS), np.nan, np.float32)
        label = np.full((*extent, VOXELS), NO_LABEL, np.uint8)
        for number, which in by_chunk(slots):
            chunk, at = self._store.chunks[number], tuple((blocks[slots[which]] - first_block).T)
            rows = slots[which] % CHUNK
            log_odds[at] = chunk.log_odds.reshape(CHUNK, VOXELS)[rows]
            if self.classes:
                known = chunk.record.reshape(CHUNK, VOXELS)[rows] != NO_RECORD
                known &= log_odds[at] >= 0
                voxels = (rows[:, None] * VOXELS + np.arange(VOXELS))[known]
                counts = chunk.counts[chunk.record[voxels]]
                some = label[at]
                some[known] = np.where(counts.any(axis=1), counts.argmax(axis=1), NO_LABEL)
                label[at] = some
        cut = tuple(slice(a, a + n) for a, n in zip(first - first_block * BLOCK, shape, strict=True))
        return DenseVoxels(self.voxel_size, first, _unfold(log_odds)[cut], _unfold(label)[cut])

    def _log_odds_by_slot(self) -> np.ndarray:
        """(slots · 512,) float32; a view where there is one chunk."""
        parts = [chunk.log_odds for chunk in self._store.chunks]
        return np.concatenate(parts) if parts else np.zeros(0, np.float32)

    def _indices(self, at: np.ndarray) -> np.ndarray:
        """Voxel indices (V, 3) of places slot · 512 + place in block, (V,)."""
        blocks = unpack_blocks(self._store.keys[at // VOXELS])
        place = at % VOXELS
        return blocks * BLOCK + np.stack([place // BLOCK**2, place // BLOCK % BLOCK, place % BLOCK], axis=-1)

    def _at(self, p_MP: np.ndarray) -> Iterator[tuple[Chunk, np.ndarray, np.ndarray]]:
        """Each chunk that holds some of the points, which they are, and their places in it."""
        keys, place = locate(p_MP, self.voxel_size)
        slots = self._store.find(keys)
        for number, which in by_chunk(slots):
            yield self._store.chunks[number], which, slots[which] % CHUNK * VOXELS + place[which]

    def _posterior(self, chunk: Chunk, voxels: np.ndarray) -> np.ndarray:
        record = chunk.record[voxels]
        has = (record != NO_RECORD) & (chunk.log_odds[voxels] >= 0)
        observed = np.full((len(voxels), self.classes), 1.0 / max(self.classes, 1))
        observed[has] += chunk.counts[record[has]] / OBSERVATION
        return (observed / observed.sum(axis=1, keepdims=True)).astype(np.float32)


def _means(chunk: Chunk, voxels: np.ndarray) -> np.ndarray:
    record = chunk.record[voxels]
    has = (record != NO_RECORD) & (chunk.log_odds[voxels] >= 0)
    means = np.full((len(voxels), chunk.means.shape[1]), np.nan, np.float32)
    means[has] = np.where(chunk.weights[record[has]] > 0, chunk.means[record[has]], np.nan)
    return means


def _probability(log_odds: np.ndarray) -> np.ndarray:
    return (1.0 / (1.0 + np.exp(-log_odds))).astype(np.float32)


def _unfold(blocks: np.ndarray) -> np.ndarray:
    """(X, Y, Z, 512) of blocks as (8 X, 8 Y, 8 Z) of voxels."""
    x, y, z = blocks.shape[:3]
    inside = blocks.reshape(x, y, z, BLOCK, BLOCK, BLOCK).transpose(0, 3, 1, 4, 2, 5)
    return inside.reshape(x * BLOCK, y * BLOCK, z * BLOCK)
