"""The surface of the ground in cells: from points to the lowest and highest height that more than one point shows."""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from .step_kernels import cell_steps
from .terrain_config import SurfaceConfig

# Of a cell with more points, every n-th is looked at.
_MOST = 64
# A cell with fewer points than this can be wrong: it counts only where a neighbour agrees.
_FEW = 3
# [m] Neighbours agree that are this near in height, and a cell's own height may spread this far.
_AGREE = 0.1


@dataclass(frozen=True, eq=False)
class SurfaceCells:
    """Heights by cell, (nx, ny). Read-only.

    Attributes:
        low, high: [m], NaN where nothing is known; `high` above `low` where an upright face was seen in the cell.
        origin: (2,) [m], of the corner of cell (0, 0).
        cell: [m].
    """

    low: np.ndarray
    high: np.ndarray
    origin: np.ndarray
    cell: float

    def __deepcopy__(self, memo: dict) -> "SurfaceCells":
        return self

    @property
    def seen(self) -> np.ndarray:
        """Where the height is known, (nx, ny) bool."""
        return np.isfinite(self.low)


def find_surface(
    points: np.ndarray,
    origin: np.ndarray,
    shape: tuple[int, int],
    cell: float,
    *,
    clearance: float = 1.0,
    ceiling: float = np.inf,
) -> SurfaceCells:
    """The surface under points (N, 3) [m], z up; what is not finite or outside the grid is left out.

    Of the heights in a cell the extreme one on either side is dropped when there are at least three, and one in
    twenty of more: a stray point makes no step, a thin pole does. A cell with fewer than three points counts only if
    one of the eight around it has a height within 0.1 m. What is more than `clearance` above the lowest height hangs
    over the ground, and what is higher than `ceiling` is left out altogether.

    Args:
        origin: (2,) [m], of the corner of cell (0, 0). shape: number of cells along x and y.
    """
    points = np.asarray(points, np.float32).reshape(-1, 3)
    low, high = _surface(
        points,
        float(origin[0]),
        float(origin[1]),
        shape[0],
        shape[1],
        float(cell),
        float(clearance),
        float(min(ceiling, 1e30)),
    )
    return SurfaceCells(low, high, np.asarray(origin, float), float(cell))


def find_steps(cells: SurfaceCells, config: SurfaceConfig) -> np.ndarray:
    """Largest step at every cell, (nx, ny) float32 [m], see `cell_steps`."""
    gap = max(1, round(config.max_gap / cells.cell))
    return cell_steps(
        cells.low, cells.high, cells.cell, gap, math.tan(math.radians(config.gap_slope_deg)), config.noise
    )


@njit(cache=True)
def _surface(
    points: np.ndarray, x0: float, y0: float, nx: int, ny: int, cell: float, clearance: float, ceiling: float
) -> tuple[np.ndarray, np.ndarray]:
    index = np.empty(points.shape[0], np.int32)
    start = np.zeros(nx * ny + 1, np.int32)
    for n in range(points.shape[0]):
        u, v, z = (points[n, 0] - x0) / cell, (points[n, 1] - y0) / cell, points[n, 2]
        # Written so that NaN is out.
        if u >= 0 and v >= 0 and u < nx and v < ny and z > -ceiling and z < ceiling:
            index[n] = int(u) * ny + int(v)
            start[index[n] + 1] += 1
        else:
            index[n] = -1
    for c in range(nx * ny):
        start[c + 1] += start[c]
    filled = start[:-1].copy()
    heights = np.empty(start[-1], np.float32)
    for n in range(points.shape[0]):
        if index[n] >= 0:
            heights[filled[index[n]]] = points[n, 2]
            filled[index[n]] += 1
    low = np.full((nx, ny), np.nan, np.float32)
    high = np.full((nx, ny), np.nan, np.float32)
    few = np.zeros((nx, ny), np.bool_)
    sample = np.empty(_MOST, np.float32)
    for i in range(nx):
        for j in range(ny):
            c = i * ny + j
            count = start[c + 1] - start[c]
            if count == 0:
                continue
            size = min(count, _MOST)
            for s in range(size):
                sample[s] = heights[start[c] + s * count // size]
            _sort(sample, size)
            bottom = sample[_dropped(size)]
            kept = size
            while sample[kept - 1] > bottom + clearance:
                kept -= 1
            low[i, j], high[i, j] = bottom, max(bottom, sample[kept - 1 - _dropped(kept)])
            few[i, j] = kept < _FEW
    for i in range(nx):
        for j in range(ny):
            if few[i, j] and not _supported(low, high, few, i, j):
                low[i, j], high[i, j] = np.nan, np.nan
    return low, high


@njit(cache=True)
def _sort(values: np.ndarray, size: int) -> None:
    for s in range(1, size):
        value, t = values[s], s
        while t > 0 and values[t - 1] > value:
            values[t] = values[t - 1]
            t -= 1
        values[t] = value


@njit(cache=True)
def _dropped(size: int) -> int:
    """How many heights are dropped on either side."""
    return (1 if size >= _FEW else 0) + size // 20


@njit(cache=True)
def _supported(low: np.ndarray, high: np.ndarray, few: np.ndarray, i: int, j: int) -> bool:
    """Whether a neighbour has about the height of cell (i, j)."""
    for a in range(max(i - 1, 0), min(i + 2, low.shape[0])):
        for b in range(max(j - 1, 0), min(j + 2, low.shape[1])):
            if (a != i or b != j) and low[i, j] <= high[a, b] + _AGREE and high[i, j] >= low[a, b] - _AGREE:
                return True
    return False
