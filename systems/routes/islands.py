"""What a route can pass on either side, and the signature that tells one way past it from the other."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label

from .route_grid import DOSE, HOT, WATER, RouteGrid

HAZARDS = (WATER, HOT, DOSE)
# So that sums of weights stay exact in 64 bits.
_WEIGHT_BITS = 40


@dataclass(frozen=True, eq=False)
class Islands:
    """Blocked parts of a grid with free cells, or room for them, all around; read-only.

    From a cell of every island a ray goes along +y to the edge of the grid. A path's signature is how often it crosses
    each ray, counted +1 along +x and −1 along −x. Two paths with the same ends have the same signature if one can be
    shifted onto the other, and so does a path that is shifted (homology; H-signature of Bhattacharya et al. 2012). What
    touches the edge of the grid is no island, since nothing passes behind it.

    Attributes:
        label: (nx, ny) int32: 0 free, -1 part of the edge, from 1 on the islands in this order.
        anchor: (m, 2) int64: the cell of each where its ray begins, the middle one of its middle column.
        hazard: (m,) uint8: the kind, of `HAZARDS`, that most of an island's hazard cells have, 0 when it has none.
        table: (nx, ny + 1) int64: sum of the random weights of the rays right of column i that begin below row j. A
            signature's weighted sum is a number that tells it from all others, up to a chance of about 1e-12.
    """

    label: np.ndarray
    anchor: np.ndarray
    hazard: np.ndarray
    table: np.ndarray

    def __len__(self) -> int:
        return len(self.anchor)

    def signature(self, grid: RouteGrid, xy: np.ndarray) -> tuple[int, ...]:
        """Crossings of every island's ray by the path (K, 2) in M [m]."""
        u = (np.asarray(xy, float) - grid.origin) / grid.cell - 0.5
        a, b = u[:-1], u[1:]
        counts = []
        for i, j in self.anchor:
            at = i + 0.5
            crosses = (a[:, 0] <= at) != (b[:, 0] <= at)
            p, q = a[crosses], b[crosses]
            y = p[:, 1] + (at - p[:, 0]) / (q[:, 0] - p[:, 0]) * (q[:, 1] - p[:, 1])
            counts.append(int(np.sign(q[:, 0] - p[:, 0])[y > j].sum()))
        return tuple(counts)

    def bearings(self, grid: RouteGrid, xy: np.ndarray) -> np.ndarray:
        """Direction from each island's anchor to the points of a path (K, 2) in M [m], without jumps, (m, K) [rad]."""
        away = np.asarray(xy, float) - grid.centre_of(self.anchor)[:, None]
        return np.asarray(np.unwrap(np.arctan2(away[..., 1], away[..., 0]), axis=1))

    def sides(self, grid: RouteGrid, xy: np.ndarray) -> tuple[str, ...]:
        """On which side the path (K, 2) in M [m] passes each island: "left" or "right" of it, "" when it does not.

        It passes one when the bearing turns by more than a quarter turn; counter-clockwise means that the island lies
        on the left, and the path goes right of it.
        """
        bearings = self.bearings(grid, xy)
        swept = bearings[:, -1] - bearings[:, 0]
        return tuple("" if abs(angle) < np.pi / 2 else "right" if angle > 0 else "left" for angle in swept)


def find_islands(grid: RouteGrid) -> Islands:
    """Finds the islands of a grid. Cells that meet at a corner are one island: no way leads between them."""
    parts, count = label(np.pad(grid.blocked, 1, constant_values=True), np.ones((3, 3)))
    parts = parts[1:-1, 1:-1].astype(np.int32)
    # The frame around the grid is the first cell that is labelled.
    parts -= 1
    parts[~grid.blocked] = 0
    parts[grid.blocked & (parts == 0)] = -1
    count -= 1
    nx, ny = grid.shape
    anchor = np.zeros((count, 2), np.int64)
    hazard = np.zeros(count, np.uint8)
    for k in range(count):
        cells = np.argwhere(parts == k + 1)
        anchor[k] = cells[np.lexsort((cells[:, 1], cells[:, 0]))[len(cells) // 2]]
        kinds = grid.kind[tuple(cells.T)]
        amounts = [(kinds == kind).sum() for kind in HAZARDS]
        if max(amounts) > 0:
            hazard[k] = HAZARDS[int(np.argmax(amounts))]
    weights = np.random.default_rng(0).integers(1, 1 << _WEIGHT_BITS, count)
    begins = np.zeros((nx, ny + 1), np.int64)
    np.add.at(begins, (anchor[:, 0], anchor[:, 1] + 1), weights)
    return Islands(parts, anchor, hazard, np.cumsum(begins, axis=1))
