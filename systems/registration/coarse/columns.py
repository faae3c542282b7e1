"""What stands on the floor, as columns seen from above: where, how high, and which way its surface faces."""

from dataclasses import dataclass

import numpy as np

from .view_kernels import column_moments


@dataclass(frozen=True, eq=False)
class Columns:
    """Occupied cells of a grid seen from above.

    A ring of a LiDAR leaves a line on a wall, of which no normal can be taken; from above, all rings of a wall lie on
    one line, and its normal is exact. So upright surfaces, which is nearly all that holds a robot on its floor, are
    compared in two dimensions.

    Attributes:
        centres: mean of the points of each, (M, 2) [m].
        normals: horizontal unit normals (M, 2), towards the sensor.
        flatness: 1 on a straight wall, 0 where there is no line at all, (M,).
        heights: lowest and highest point (M, 2) [m].
        classes: mean class probabilities (M, K); K is 0 without classes.
    """

    centres: np.ndarray
    normals: np.ndarray
    flatness: np.ndarray
    heights: np.ndarray
    classes: np.ndarray
    _keys: np.ndarray
    _cell: float

    def thin(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean point of every cube of one cell (N, 3), and the column (N,) it stands in; of the points given before."""
        if len(points) == 0:
            return points, np.zeros(0, np.int64)
        column = np.searchsorted(self._keys, _keys(points, self._cell))
        layer = np.floor(points[:, 2] / self._cell).astype(np.int64)
        cube = column * 4096 + layer + 2048
        order = np.argsort(cube, kind="stable")
        starts = _starts(cube[order])
        count = np.diff(np.append(starts, len(points)))[:, None]
        means = np.add.reduceat(points[order], starts, axis=0) / count
        return np.ascontiguousarray(means), column[order][starts]


def find_columns(points: np.ndarray, seen_from: np.ndarray | None, cell: float, classes: np.ndarray) -> Columns:
    """The columns of `points` (N, 3) [m, z up] in a grid of `cell` [m], with `classes` (N, K).

    Args:
        seen_from: where the sensor was (3,); None leaves the normals' signs arbitrary.
    """
    keys = _keys(points, cell)
    order = np.argsort(keys, kind="stable")
    starts = _starts(keys[order]) if len(points) else np.zeros(0, np.int64)
    unique = keys[order][starts]
    x, y, z = points[order].T
    if len(points) == 0:
        empty = np.zeros((0, 2))
        return Columns(empty, empty, np.zeros(0), empty, np.zeros((0, classes.shape[1])), unique, cell)
    count = np.diff(np.append(starts, len(points))).astype(float)
    sums = np.column_stack([count, *(np.add.reduceat(v, starts) for v in (x, y, x * x, x * y, y * y))])
    heights = np.column_stack([np.minimum.reduceat(z, starts), np.maximum.reduceat(z, starts)])
    means = np.add.reduceat(classes[order], starts, axis=0) / count[:, None]
    eye = np.zeros(2) if seen_from is None else np.ascontiguousarray(seen_from[:2], float)
    normals, flatness = column_moments(unique, sums, eye)
    centres = np.ascontiguousarray(sums[:, 1:3] / count[:, None])
    return Columns(centres, normals, flatness, np.ascontiguousarray(heights), np.ascontiguousarray(means), unique, cell)


_HALF = 1 << 20


def _keys(points: np.ndarray, cell: float) -> np.ndarray:
    index = np.floor(points[:, :2] / cell).astype(np.int64) + _HALF
    return (index[:, 0] << 32) | index[:, 1]


def _starts(keys: np.ndarray) -> np.ndarray:
    """Where a new key begins in sorted ones."""
    return np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
