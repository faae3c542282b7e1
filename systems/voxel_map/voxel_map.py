"""A map of voxels: where space is free and where it is occupied, and what is there."""

from collections.abc import Mapping, Sequence

import numpy as np
from open3d.t.geometry import PointCloud

from ..clouds import transform_points
from ..config import check_config
from .block_store import CHUNK, BlockStore, add_observations, assign_records, by_chunk, update_blocks
from .carving import VOXELS, CarvedScan, carve, split_indices
from .merging import add_blocks, all_blocks, is_still, move_blocks
from .voxel_map_config import VoxelMapConfig
from .voxel_view import VoxelView

# Attributes of a cloud whose mean is kept for every occupied voxel.
CHANNELS = ("intensity", "nir", "temperature", "dose_rate")


class VoxelMap(VoxelView):
    """Log-odds of occupancy per voxel of a grid, with classes and means of channels where it is occupied.

    A voxel is unknown, free (log-odds < 0) or occupied (≥ 0). Evidence is added as OctoMap does: every voxel at most
    once a scan, hits win over rays that pass, clamped. The cost of a scan depends on the scan alone, not on the map.

    An occupied voxel counts its points by class and averages `channels` of them. Class counts start from one
    observation spread over all classes, and all are halved when one is full. A voxel that becomes free forgets both.

    `copy` costs almost nothing, since blocks are shared until one of the two writes; `freeze` forbids writing.
    """

    def __init__(
        self, config: VoxelMapConfig | None = None, *, classes: int = 0, channels: Sequence[str] = CHANNELS
    ) -> None:
        """Makes a map of which all is unknown.

        Args:
            classes: K; 0 to take it from the first scan that has classes.
            channels: names of the channels that are averaged.

        Raises:
            ConfigError: a value of the configuration is out of range.
        """
        config = config or VoxelMapConfig()
        check_config(config)
        super().__init__(config, channels, BlockStore(classes, len(channels)))
        self._expected_blocks = 1024
        self._frozen = False

    def __deepcopy__(self, memo: dict) -> "VoxelMap":
        return self if self._frozen else self.copy()

    def copy(self) -> "VoxelMap":
        """A map of the same content that can be written to."""
        other = VoxelMap.__new__(VoxelMap)
        other.__dict__.update(self.__dict__)
        other._store, other._frozen = self._store.copy(), False
        return other

    def freeze(self) -> "VoxelMap":
        """Forbids writing, for good; returns the map."""
        self._frozen = True
        return self

    def insert(
        self,
        p_MP: np.ndarray,
        p_MS: np.ndarray,
        *,
        class_probabilities: np.ndarray | None = None,
        channels: Mapping[str, np.ndarray] | None = None,
        numbers: np.ndarray | None = None,
        rays: np.ndarray | None = None,
    ) -> None:
        """Adds one scan.

        Args:
            p_MP: points (N, 3) [m]; those that are not finite are left out.
            p_MS: where their rays start, (3,) [m].
            class_probabilities: (N, K); a row with NaN says nothing.
            channels: values (N,) by name; NaN says nothing, names that are not in `self.channels` are left out.
            numbers: (N,) of how many measurements each point is the mean; 1 when not given.
            rays: (N,) bool, which points have a ray; the others, seen from elsewhere, only hit.

        Raises:
            ValueError: the map is frozen, a shape is wrong, or K differs from that of the map.
        """
        self._check_writable()
        count, config = len(p_MP), self.config
        classes = self._checked_classes(class_probabilities, count)
        values = np.full((count, len(self.channels)), np.nan, np.float32)
        for i, name in enumerate(self.channels):
            if channels is not None and name in channels:
                values[:, i] = np.reshape(channels[name], count)
        number = np.ones(count) if numbers is None else np.reshape(numbers, count).astype(float)
        scan = carve(p_MP, p_MS, config.voxel_size, config.max_range, rays, self._expected_blocks)
        self._expected_blocks = max(1024, len(scan.keys) + len(scan.keys) // 2)
        slots = self._store.find_or_add(scan.keys)
        steps = config.log_odds_steps()
        for chunk_number, rows in by_chunk(slots):
            chunk = self._store.writable(chunk_number)
            blocks = slots[rows] % CHUNK
            update_blocks(chunk.log_odds, chunk.record, chunk.counts, chunk.weights, blocks, scan.marks, rows, steps)
        says_something = np.isfinite(values).any(axis=1)
        if self.classes:
            says_something |= np.isfinite(classes.sum(axis=1))
        self._observe(scan, slots, np.flatnonzero(says_something & (scan.target >= 0)), classes, values, number)

    def _observe(
        self,
        scan: CarvedScan,
        slots: np.ndarray,
        points: np.ndarray,
        classes: np.ndarray,
        values: np.ndarray,
        number: np.ndarray,
    ) -> None:
        """Adds what `points` say to the records of the voxels that they hit."""
        at = slots[scan.target[points] // VOXELS] * VOXELS + scan.target[points] % VOXELS
        for chunk_number, which in by_chunk(at // VOXELS):
            chunk, some = self._store.chunks[chunk_number], points[which]
            voxels = at[which] - chunk_number * CHUNK * VOXELS
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
                classes[some] * number[some, None],
                values[some].astype(float),
                np.repeat(number[some, None], values.shape[1], axis=1),
            )

    def insert_cloud(self, cloud: PointCloud, X_MC: np.ndarray, p_CS: np.ndarray) -> None:
        """Adds a cloud with the attributes that it has: `class_probabilities`, `count` and the channels.

        Where there is `intensity`, points without (NaN) are of another sensor and carve nothing.

        Args:
            X_MC: pose (4, 4) of the cloud's frame C.
            p_CS: the LiDAR in C (3,) [m].
        """
        if "positions" not in cloud.point:
            return
        names = {name for name, _ in cloud.point.items()}
        values = {name: cloud.point[name].numpy()[:, 0] for name in self.channels if name in names}
        self.insert(
            transform_points(X_MC, cloud.point.positions.numpy().astype(float)),
            X_MC[:3, :3] @ np.asarray(p_CS, float) + X_MC[:3, 3],
            class_probabilities=cloud.point["class_probabilities"].numpy() if "class_probabilities" in names else None,
            channels=values,
            numbers=cloud.point["count"].numpy() if "count" in names else None,
            rays=np.isfinite(cloud.point["intensity"].numpy()[:, 0]) if "intensity" in names else None,
        )

    def set_voxels(self, indices: np.ndarray, log_odds: np.ndarray) -> None:
        """Sets the log-odds (V,) of voxels by their `indices` (V, 3), as read from a file; no voxel may come twice.

        Raises:
            ValueError: the map is frozen, or a value is not finite.
        """
        self._check_writable()
        if not np.isfinite(log_odds).all():
            raise ValueError("log-odds are not finite")
        keys, places = split_indices(np.asarray(indices, np.int64))
        self._store.find_or_add(np.unique(keys))
        slots = self._store.find(keys)
        for number, which in by_chunk(slots):
            self._store.writable(number).log_odds[slots[which] % CHUNK * VOXELS + places[which]] = log_odds[which]

    def merge(self, other: VoxelView, X: np.ndarray | None = None) -> None:
        """Adds everything that `other` knows, moved by the pose X (4, 4) where it is given, see `move_blocks`.

        Log-odds are added and clamped. Without motion the result is that of inserting the scans of both into one map,
        but for clamping.

        Raises:
            ValueError: the map is frozen, or voxel size, channels or number of classes differ.
        """
        self._check_writable()
        mine, theirs = (self.voxel_size, self.channels), (other.voxel_size, other.channels)
        if mine != theirs:
            raise ValueError(f"maps of voxel size and channels {mine} and {theirs} cannot be merged")
        if other.classes:
            self._checked_classes(np.zeros((0, other.classes)), 0)
        blocks = all_blocks(other._store)
        if X is not None and not is_still(X):
            blocks = move_blocks(blocks, X, self.voxel_size)
        low, high = self.config.log_odds_steps()[2:]
        add_blocks(self._store, blocks, low, high)

    def _check_writable(self) -> None:
        if self._frozen:
            raise ValueError("this map is frozen; write to a copy")

    def _checked_classes(self, probabilities: np.ndarray | None, points: int) -> np.ndarray:
        """Class probabilities (N, K) float64 as they are stored, NaN where none are given; takes K from the first."""
        if probabilities is None:
            return np.full((points, self.classes), np.nan)
        if probabilities.ndim != 2 or len(probabilities) != points:
            raise ValueError(f"class probabilities {probabilities.shape} are not ({points}, K)")
        if self.classes == 0:
            self._store.set_classes(probabilities.shape[1])
        if probabilities.shape[1] != self.classes:
            raise ValueError(f"class probabilities of {probabilities.shape[1]} classes in a map of {self.classes}")
        return probabilities.astype(float)
