"""The grid that routes are planned on: what each cell is, what a metre there costs, how high it lies."""

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import distance_transform_edt

from ..errors import InputError

FREE, OCCUPIED, WATER, HOT, DOSE, UNKNOWN, FENCE = range(7)
KINDS = ("free", "occupied", "water", "hot", "dose", "unknown", "fence")
TERRAINS = ("flat", "slope", "steps", "rough")


@dataclass(frozen=True, eq=False)
class RouteGrid:
    """Cells of the floor plan in the map frame M, seen from above; read-only.

    Cell (i, j) covers [origin + cell (i, j), origin + cell (i + 1, j + 1)). What lies outside the grid is a fence.
    Only free cells can be entered by the reference point of the robot: whoever builds the grid has grown the
    obstacles by the robot already.

    Attributes:
        kind: (nx, ny) uint8, index into `KINDS`.
        cost: (nx, ny) float32, at least 1; multiplies the length of a way through the cell.
        height: (nx, ny) float32, height of the floor in M [m], NaN where it is not known.
        dose_rate: (nx, ny) float32, in the unit of the map (µSv/h by default), 0 where nothing was measured.
        clearance: (nx, ny) float32, from the centre of the cell to the nearest centre that is not free [m].
        terrain: (nx, ny) uint8, index into `TERRAINS`: which outcomes the motions have there.
        origin: (2,) corner of cell (0, 0) in M [m].
        cell: edge of a cell [m].
    """

    kind: np.ndarray
    cost: np.ndarray
    height: np.ndarray
    dose_rate: np.ndarray
    clearance: np.ndarray
    terrain: np.ndarray
    origin: np.ndarray
    cell: float

    @classmethod
    def from_kind(
        cls,
        kind: np.ndarray,
        cell: float,
        origin: np.ndarray | tuple[float, float] = (0.0, 0.0),
        *,
        cost: np.ndarray | None = None,
        height: np.ndarray | None = None,
        dose_rate: np.ndarray | None = None,
        clearance: np.ndarray | None = None,
        terrain: np.ndarray | None = None,
    ) -> "RouteGrid":
        """Makes a grid of copies; what is not given is flat, cheap, without dose, and `clearance` is computed.

        Raises:
            InputError: wrong shape, unknown kind or terrain, cost below 1, cell not positive.
        """
        kind = np.array(kind, np.uint8)
        if kind.ndim != 2 or 0 in kind.shape:
            raise InputError("kind must be a plane of cells", where="RouteGrid", value=kind.shape, valid="(nx, ny)")
        if not np.isfinite(cell) or cell <= 0:
            raise InputError("cell must be positive", where="RouteGrid", value=cell, valid="> 0 m")
        layers = {
            "cost": _layer("cost", cost, kind.shape, 1.0),
            "height": _layer("height", height, kind.shape, 0.0),
            "dose_rate": _layer("dose_rate", dose_rate, kind.shape, 0.0),
            "terrain": _layer("terrain", terrain, kind.shape, 0).astype(np.uint8),
        }
        if not (layers["cost"] >= 1).all():
            raise InputError("cost below 1", where="RouteGrid", value=float(layers["cost"].min()), valid=">= 1")
        for name, values, names in (("kind", kind, KINDS), ("terrain", layers["terrain"], TERRAINS)):
            if values.max() >= len(names):
                raise InputError(f"unknown {name}", where="RouteGrid", value=int(values.max()), valid=names)
        layers["clearance"] = (
            clearance_of(kind, cell) if clearance is None else _layer("clearance", clearance, kind.shape, 0.0)
        )
        corner = np.array(origin, float)
        if corner.shape != (2,) or not np.isfinite(corner).all():
            raise InputError("origin must be x, y", where="RouteGrid", value=origin, valid="(2,) finite [m]")
        for array in (kind, corner, *layers.values()):
            array.flags.writeable = False
        return cls(kind=kind, origin=corner, cell=float(cell), **layers)

    @property
    def shape(self) -> tuple[int, int]:
        return self.kind.shape[0], self.kind.shape[1]

    @cached_property
    def blocked(self) -> np.ndarray:
        """(nx, ny) bool: cells that are not free."""
        return self.kind != FREE

    @cached_property
    def fingerprint(self) -> str:
        """16 hexadecimal digits that tell this grid from one with other cells, another place or another size."""
        digest = hashlib.sha256(np.array([*self.origin, self.cell]).tobytes() + np.array(self.shape).tobytes())
        for layer in (self.kind, self.cost, self.terrain):
            digest.update(layer.tobytes())
        return digest.hexdigest()[:16]

    def contains(self, xy: np.ndarray) -> np.ndarray:
        """(...) bool: whether points (..., 2) in M [m] lie in the grid; what is not finite does not."""
        cells = (np.asarray(xy, float) - self.origin) / self.cell
        return np.asarray(((cells >= 0) & (cells < self.shape)).all(axis=-1))

    def index_of(self, xy: np.ndarray) -> np.ndarray:
        """(..., 2) int64: the cells of points (..., 2) in M [m].

        Raises:
            InputError: a point lies outside the grid; the error names the nearest free cell.
        """
        xy = np.asarray(xy, float)
        outside = ~self.contains(xy)
        if outside.any():
            raise InputError(
                "point outside the grid",
                where="RouteGrid",
                value=_words(xy.reshape(-1, 2)[np.flatnonzero(outside)[0]]),
                valid=self._range_in_words(xy.reshape(-1, 2)[np.flatnonzero(outside)[0]]),
            )
        # A point just below the far edge may round onto it.
        return np.minimum(((xy - self.origin) / self.cell).astype(np.int64), np.array(self.shape) - 1)

    def free_index_of(self, xy: np.ndarray, what: str = "point") -> np.ndarray:
        """(2,) int64: the cell of point (2,) in M [m].

        Raises:
            InputError: `what` lies outside the grid or in a cell that is not free; names the nearest free cell.
        """
        xy = np.asarray(xy, float)
        if not self.contains(xy):
            raise InputError("outside the grid", where=what, value=_words(xy), valid=self._range_in_words(xy))
        index = self.index_of(xy)
        kind = self.kind[tuple(index)]
        if kind != FREE:
            raise InputError(
                f"in a cell that is {KINDS[kind]}",
                where=what,
                value=_words(xy),
                valid=self._nearest_in_words(xy),
            )
        return index

    def centre_of(self, ij: np.ndarray) -> np.ndarray:
        """(..., 2) centres of cells (..., 2) in M [m]."""
        return self.origin + (np.asarray(ij) + 0.5) * self.cell

    def nearest_free(self, xy: np.ndarray) -> np.ndarray | None:
        """(2,) int64: the free cell whose centre is nearest to `xy` (2,) in M [m], None when no cell is free."""
        free = np.argwhere(~self.blocked)
        xy = np.asarray(xy, float)
        if not len(free) or not np.isfinite(xy).all():
            return None
        return free[np.argmin(((self.centre_of(free) - xy) ** 2).sum(axis=1))]

    def _range_in_words(self, xy: np.ndarray) -> str:
        low, high = self.origin, self.origin + np.array(self.shape) * self.cell
        return f"x {low[0]:g} to {high[0]:g} m, y {low[1]:g} to {high[1]:g} m; {self._nearest_in_words(xy)}"

    def _nearest_in_words(self, xy: np.ndarray) -> str:
        cell = self.nearest_free(xy)
        return "no cell is free" if cell is None else f"nearest free cell at {_words(self.centre_of(cell))}"


def clearance_of(kind: np.ndarray, cell: float) -> np.ndarray:
    """(nx, ny) float32: distance from each centre to the nearest centre that is not free [m]; 0 in those.

    What lies outside the grid counts as not free.
    """
    free = np.pad(kind == FREE, 1)
    return (distance_transform_edt(free)[1:-1, 1:-1] * cell).astype(np.float32)


def _layer(name: str, values: np.ndarray | None, shape: tuple[int, ...], default: float) -> np.ndarray:
    layer = np.full(shape, default, np.float32) if values is None else np.array(values, np.float32)
    if layer.shape != shape:
        raise InputError(f"{name} does not fit kind", where="RouteGrid", value=layer.shape, valid=str(shape))
    return layer


def _words(xy: np.ndarray) -> str:
    return f"({xy[0]:.3f}, {xy[1]:.3f}) m"
