"""A box of a voxel map as dense arrays: what planning and learning of routes need."""

from dataclasses import dataclass

import numpy as np

UNKNOWN, FREE, OCCUPIED = -1, 0, 1
NO_LABEL = 255
_MOST = 1 << 30


@dataclass(frozen=True, eq=False)
class DenseVoxels:
    """A box of voxels. Read-only.

    Attributes:
        voxel_size: [m]
        first: index (3,) int64 of voxel [0, 0, 0] of the arrays in the grid, whose voxel i reaches from i to i + 1
            times `voxel_size`.
        log_odds: (X, Y, Z) float32, NaN where unknown.
        label: (X, Y, Z) uint8, the most observed class of occupied voxels, `NO_LABEL` where there is none.
    """

    voxel_size: float
    first: np.ndarray
    log_odds: np.ndarray
    label: np.ndarray

    @property
    def state(self) -> np.ndarray:
        """`UNKNOWN`, `FREE` or `OCCUPIED`, (X, Y, Z) int8."""
        return voxel_state(self.log_odds)

    @property
    def origin(self) -> np.ndarray:
        """Lowest corner of the box, (3,) [m]."""
        return self.first * self.voxel_size

    def centres(self, indices: np.ndarray) -> np.ndarray:
        """Centres (N, 3) [m] of the voxels at `indices` (N, 3) of the arrays."""
        return (np.asarray(indices) + self.first + 0.5) * self.voxel_size

    def indices(self, points: np.ndarray) -> np.ndarray:
        """Indices (N, 3) int64 into the arrays of the voxels of finite points (N, 3) [m]; they may be outside."""
        return np.floor(np.asarray(points, float) / self.voxel_size).astype(np.int64) - self.first


def voxel_state(log_odds: np.ndarray) -> np.ndarray:
    """`UNKNOWN`, `FREE` or `OCCUPIED` (int8) of log-odds of any shape, NaN where unknown."""
    with np.errstate(invalid="ignore"):
        return np.where(np.isnan(log_odds), UNKNOWN, np.where(log_odds >= 0, OCCUPIED, FREE)).astype(np.int8)


def dense_shape(low: np.ndarray, high: np.ndarray, voxel: float) -> tuple[np.ndarray, np.ndarray]:
    """First index (3,) and shape (3,) int64 of the voxels that the box from `low` to `high` touches.

    Raises:
        ValueError: the box is empty, not finite, or has more than 2^30 voxels.
    """
    low, high = np.asarray(low, float), np.asarray(high, float)
    if low.shape != (3,) or high.shape != (3,) or not (np.isfinite(low) & np.isfinite(high) & (low < high)).all():
        raise ValueError(f"the box from {low} to {high} is empty or not finite")
    # A face that lies on a border of voxels, but for rounding, does not touch those on its other side.
    first, last = np.floor(low / voxel + 1e-6), np.ceil(high / voxel - 1e-6)
    if np.prod(last - first) > _MOST:
        raise ValueError(f"the box from {low} to {high} has more than 2^30 voxels of {voxel:g} m")
    return first.astype(np.int64), np.maximum(last - first, 1).astype(np.int64)
