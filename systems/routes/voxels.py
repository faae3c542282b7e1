"""The voxels of a semantic map: what each is (S0-h)."""

from dataclasses import dataclass

import numpy as np
from open3d.t.geometry import PointCloud

from ..hazards.classes import HEAT
from ..hazards.classes import WATER as WATER_POINT
from .make_grid import map_points
from .route_grid import DOSE, FREE, HOT, OCCUPIED, WATER, RouteGrid


@dataclass(frozen=True, eq=False)
class Voxels:
    """Voxels with points in them, sorted by index; read-only.

    Attributes:
        index: (N, 3) int64; voxel (i, j, k) begins at `size` times its index in M.
        kind: (N,) uint8 of `KINDS`: water, hot or dose rate by its points, free for ground that is driven on, occupied.
        size: edge [m].
    """

    index: np.ndarray
    kind: np.ndarray
    size: float

    def __deepcopy__(self, memo: dict) -> "Voxels":
        return self

    @property
    def centres(self) -> np.ndarray:
        """(N, 3) in M [m]."""
        return (self.index + 0.5) * self.size


def make_voxels(cloud: PointCloud, grid: RouteGrid, *, voxel: float, max_dose_rate: float, step: float) -> Voxels:
    """Sorts the points of a semantic map into voxels.

    A voxel is water or hot when any of its points is, of high dose when their mean is above `max_dose_rate` [µSv/h],
    ground when its centre is at most `step` [m] above the ground of its cell of `grid`, and else occupied.
    """
    points = map_points(cloud)
    cells = np.floor(points.xyz / voxel).astype(np.int64)
    low = cells.min(axis=0, initial=0)
    shape = cells.max(axis=0, initial=0) - low + 1
    # One number a voxel is sorted much faster than three.
    numbers, which = np.unique(np.ravel_multi_index(tuple((cells - low).T), tuple(shape)), return_inverse=True)
    index = np.column_stack(np.unravel_index(numbers, tuple(shape))).astype(np.int64) + low
    count = len(index)
    kind = np.full(count, OCCUPIED, np.uint8)
    centres = (index + 0.5) * voxel
    inside = grid.contains(centres[:, :2])
    i, j = grid.index_of(centres[inside, :2]).T
    ground = np.zeros(count, bool)
    ground[inside] = centres[inside, 2] <= grid.height[i, j] + step + 0.5 * voxel
    kind[ground] = FREE
    known = np.isfinite(points.dose_rate)
    share = np.bincount(which[known], minlength=count)
    total = np.bincount(which[known], weights=points.dose_rate[known], minlength=count)
    kind[total > max_dose_rate * np.maximum(share, 1)] = DOSE
    for label, wanted in ((HEAT.id, HOT), (WATER_POINT.id, WATER)):
        kind[which[points.label == label]] = wanted
    return Voxels(index, kind, voxel)
