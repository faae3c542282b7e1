"""A 2D occupancy grid that grows with what it is shown."""

from dataclasses import dataclass, field, replace

import numpy as np

from ..config import check_config, quantity
from ..errors import InputError
from .grid_kernels import NOBODY, PLAN, add_scan
from .planar import transform

# A grid with more cells comes from a pose that is kilometres off.
_MOST_CELLS = 100_000_000
# Grids grow by whole blocks of so many cells, so that they do not grow with every scan, and keep a border of so many
# around what was seen, for the distances there.
_BLOCK, _BORDER = 64, 16


class OccupancyGridError(InputError):
    """An occupancy grid, or what one was to be made of, is not usable."""


@dataclass(kw_only=True)
class OccupancyConfig:
    """Cells of the grid, and what a beam says of them."""

    # [m] Edge of a cell.
    resolution: float = quantity(0.05, unit="m", above=0)
    # [m] Farther returns are not entered: their error of position grows with that of the heading.
    max_range: float = quantity(30.0, unit="m", above=0)
    # [m] Beams that end farther apart than this do not show which way a surface runs.
    sparse: float = quantity(0.2, unit="m", above=0)
    # [log-odds] Of a cell that a beam ends in, 0.85: 70 %; of one that it crosses, -0.4: 40 %.
    hit: float = quantity(0.85, unit="log-odds", above=0)
    miss: float = quantity(-0.4, unit="log-odds", high=-0.01)
    # [log-odds] Where evidence stops, so that the map can still change: 12 % and 97 %.
    lowest: float = quantity(-2.0, unit="log-odds", high=-0.01)
    highest: float = quantity(3.5, unit="log-odds", above=0)


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """Log-odds of cells being occupied. Read-only: what adds to it returns another.

    Cell (i, j) covers x from origin[0] + i·resolution and y from origin[1] + j·resolution in the map frame M.

    Attributes:
        log_odds: (nx, ny) float32; 0 where nothing is known.
        origin: (2,) [m], of the corner of cell (0, 0). resolution: [m].
        hits: (nx, ny, 5) float32, where in a cell beams ended and from where they came, see `grid_kernels`.
        owner: (nx, ny) int32, number of the scan that hit a cell first, or `PLAN`, or `NOBODY`.
    """

    log_odds: np.ndarray
    origin: np.ndarray
    resolution: float
    hits: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 5), np.float32))
    owner: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), np.int32))

    def __post_init__(self) -> None:
        log_odds = np.asarray(self.log_odds, np.float32)
        origin = np.array(self.origin, np.float64).reshape(-1)
        if log_odds.ndim != 2:
            raise OccupancyGridError("wrong shape", where="occupancy grid", value=log_odds.shape, valid="(nx, ny)")
        if not np.isfinite(log_odds).all() or len(origin) != 2 or not np.isfinite(origin).all():
            raise OccupancyGridError("not finite", where="occupancy grid", valid="finite log-odds, origin (2,) [m]")
        if not (np.isfinite(self.resolution) and self.resolution > 0):
            raise OccupancyGridError("resolution", where="occupancy grid", value=self.resolution, valid="> 0 m")
        hits, owner = self.hits, self.owner
        if hits.shape[:2] != log_odds.shape:
            hits = np.zeros((*log_odds.shape, 5), np.float32)
        if owner.shape != log_odds.shape:
            owner = np.full(log_odds.shape, NOBODY, np.int32)
        for name, array in (("log_odds", log_odds), ("origin", origin), ("hits", hits), ("owner", owner)):
            array = array.view()
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def __deepcopy__(self, memo: dict) -> "OccupancyGrid":
        return self

    @staticmethod
    def empty(config: OccupancyConfig | None = None) -> "OccupancyGrid":
        """A grid without cells; it grows with the first scan."""
        config = config or OccupancyConfig()
        check_config(config, key="occupancy")
        return OccupancyGrid(np.zeros((0, 0), np.float32), np.zeros(2), config.resolution)

    @staticmethod
    def from_plan(
        occupied: np.ndarray, resolution: float, origin: np.ndarray | None = None, config: OccupancyConfig | None = None
    ) -> "OccupancyGrid":
        """The grid of a plan that is known: every cell is occupied or free.

        Args:
            occupied: (nx, ny) bool, first axis along x.
            origin: (2,) [m], of the corner of cell (0, 0), (0, 0) when not given.
        """
        config = config or OccupancyConfig()
        check_config(config, key="occupancy")
        known = np.where(np.asarray(occupied, bool), config.highest, config.lowest).astype(np.float32)
        owner = np.where(known > 0, PLAN, NOBODY).astype(np.int32)
        return OccupancyGrid(known, np.zeros(2) if origin is None else origin, resolution, owner=owner)

    @property
    def shape(self) -> tuple[int, int]:
        return self.log_odds.shape[0], self.log_odds.shape[1]

    @property
    def occupied(self) -> np.ndarray:
        """More likely occupied than not, (nx, ny) bool."""
        return self.log_odds > 0

    @property
    def free(self) -> np.ndarray:
        """More likely free than not, (nx, ny) bool."""
        return self.log_odds < 0

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Lowest and highest x, lowest and highest y [m]: what an image of `log_odds.T` with its origin below spans."""
        far = self.origin + self.resolution * np.array(self.shape)
        return float(self.origin[0]), float(far[0]), float(self.origin[1]), float(far[1])

    def cells_of(self, p_MP: np.ndarray) -> np.ndarray:
        """Points (n, 2) [m] in cells from the corner of cell (0, 0), (n, 2)."""
        return (np.asarray(p_MP, np.float64) - self.origin) / self.resolution

    def entropy(self) -> float:
        """Sum over the cells that were seen of the entropy of being occupied [bit]; the sharper the map, the lower."""
        p = 1 / (1 + np.exp(-np.abs(self.log_odds[self.log_odds != 0].astype(np.float64))))
        return float(-(p * np.log2(p) + (1 - p) * np.log2(1 - p)).sum())

    def grown(self, low: np.ndarray, high: np.ndarray) -> "OccupancyGrid":
        """The grid with room for the box from `low` to `high`, (2,) [m] each; itself when it has that already."""
        empty = min(self.shape) == 0
        origin = np.floor(low / self.resolution) * self.resolution if empty else self.origin
        first = np.floor((low - origin) / self.resolution).astype(np.int64) - _BORDER
        last = np.floor((high - origin) / self.resolution).astype(np.int64) + _BORDER + 1
        before = np.maximum(-(first // _BLOCK) * _BLOCK, 0)
        after = np.maximum(-((np.array(self.shape) - last) // _BLOCK) * _BLOCK, 0)
        if not before.any() and not after.any():
            return self
        shape = np.array(self.shape) + before + after
        if shape.prod() > _MOST_CELLS:
            value, valid = (shape * self.resolution).round(1).tolist(), f"{_MOST_CELLS} cells at most"
            raise OccupancyGridError("the points reach too far", where="occupancy grid", value=value, valid=valid)
        inside = tuple(slice(b, b + n) for b, n in zip(before, self.shape, strict=True))
        log_odds, hits = np.zeros(shape, np.float32), np.zeros((*shape, 5), np.float32)
        owner = np.full(shape, NOBODY, np.int32)
        log_odds[inside], hits[inside], owner[inside] = self.log_odds, self.hits, self.owner
        return OccupancyGrid(log_odds, origin - before * self.resolution, self.resolution, hits, owner)

    def with_scan(
        self, p_SP: np.ndarray, X_MS: np.ndarray, config: OccupancyConfig | None = None, *, number: int = 0
    ) -> "OccupancyGrid":
        """The grid after a scan.

        Args:
            p_SP: where its beams ended, (n, 2) [m]; farther ones than `max_range` are left out.
            X_MS: pose of the sensor (3,).
            number: what the cells that are hit for the first time get as owner.
        """
        config = config or OccupancyConfig()
        p_SP = p_SP[np.square(p_SP).sum(axis=1) < config.max_range**2]
        if len(p_SP) == 0:
            return self
        p_MP = transform(np.asarray(X_MS, np.float64), np.ascontiguousarray(p_SP, np.float64))
        laser = np.asarray(X_MS[:2], np.float64)
        if not (np.isfinite(p_MP).all() and np.isfinite(laser).all()):
            raise OccupancyGridError("not finite", where="occupancy grid", key="scan", valid="finite points and pose")
        low, high = np.minimum(p_MP.min(axis=0), laser), np.maximum(p_MP.max(axis=0), laser)
        grid = self.grown(low, high)
        log_odds, hits, owner = grid.log_odds.copy(), grid.hits.copy(), grid.owner.copy()
        add_scan(
            log_odds, hits, owner, grid.cells_of(laser), grid.cells_of(p_MP),
            config.hit, config.miss, config.lowest, config.highest, config.sparse / self.resolution, number,
        )  # fmt: skip
        return replace(grid, log_odds=log_odds, hits=hits, owner=owner)
