"""The floor plan of a hall: where the walls are, where the robot starts and where it measures."""

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import distance_transform_edt, label

from ..errors import PlanError
from .ray_kernels import sight_table

_MOST_CELLS = 50_000_000


@dataclass(frozen=True, eq=False)
class FloorPlan:
    """A floor plan. Read-only.

    Attributes:
        occupied: (rows, cols) bool; row 0 is at the smallest y, column 0 at the smallest x.
        resolution: side of a cell [m].
        origin: (2,) corner of cell (0, 0) in W [m].
        start: (3,) x, y, heading in W [m, m, rad].
        measuring_points: (n, 2) in W [m].
        walls: (m, 2, 2) middle lines of the walls, from and to in W [m]; empty when the plan was an image.
        wall_thickness: [m] of what is drawn along `walls`; a wall ends half of that beyond its points.
    """

    occupied: np.ndarray
    resolution: float
    origin: np.ndarray
    start: np.ndarray
    measuring_points: np.ndarray
    walls: np.ndarray = field(default_factory=lambda: np.zeros((0, 2, 2)))
    wall_thickness: float = 0.2

    def __deepcopy__(self, memo: dict) -> "FloorPlan":
        return self

    @property
    def size(self) -> np.ndarray:
        """(2,) extent along x and y [m]."""
        return np.array(self.occupied.shape[::-1]) * self.resolution

    def cell_of(self, points: np.ndarray) -> np.ndarray:
        """(..., 2) row and column of points (..., 2) [m] in W; may lie outside the plan."""
        return np.floor((np.asarray(points, float) - self.origin) / self.resolution).astype(int)[..., ::-1]

    def centre_of(self, cells: np.ndarray) -> np.ndarray:
        """(..., 2) middles in W [m] of cells (..., 2), row and column."""
        return self.origin + (np.asarray(cells)[..., ::-1] + 0.5) * self.resolution

    def is_occupied(self, points: np.ndarray) -> np.ndarray:
        """Whether points (..., 2) [m] are in a wall or outside the plan."""
        cells = self.cell_of(points)
        inside = ((cells >= 0) & (cells < self.occupied.shape)).all(axis=-1)
        row, col = np.moveaxis(np.where(inside[..., None], cells, 0), -1, 0)
        return ~inside | self.occupied[row, col]

    def sight(self, eyes: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """(n, m) whether no wall is between the points `eyes` (n, 2) and `targets` (m, 2) in W [m]."""
        a, b = (
            (np.asarray(points, float).reshape(-1, 2) - self.origin) / self.resolution for points in (eyes, targets)
        )
        return sight_table(self.occupied, a, b, 0.0, np.inf)

    def clearance(self) -> np.ndarray:
        """(rows, cols) distance from every cell's middle to a wall's face or the edge of the plan [m]; 0 in walls."""
        cells = distance_transform_edt(np.pad(~self.occupied, 1))[1:-1, 1:-1]
        return np.maximum(cells - 0.5, 0) * self.resolution

    def wall_boxes(self) -> np.ndarray:
        """(k, 4) boxes x0, y0, x1, y1 [m] that cover the occupied cells exactly, none twice: runs of a row, those of
        neighbouring rows that are alike joined."""
        boxes: list[list[int]] = []
        open_runs: dict[tuple[int, int], int] = {}
        for row, line in enumerate(self.occupied):
            edges = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]]).astype(np.int8))).reshape(-1, 2)
            runs: dict[tuple[int, int], int] = {}
            for left, right in edges.tolist():
                k = open_runs.get((left, right))
                if k is None:
                    k = len(boxes)
                    boxes.append([left, row, right, row])
                boxes[k][3] = row + 1
                runs[left, right] = k
            open_runs = runs
        return np.tile(self.origin, 2) + np.array(boxes, float).reshape(-1, 4) * self.resolution

    def with_boxes(self, sites: np.ndarray, side: float = 0.5) -> "FloorPlan":
        """The plan with square boxes of `side` [m] centred on `sites` (k, 2) [m]: the landmarks that are added."""
        occupied = self.occupied.copy()
        for x, y in np.asarray(sites, float).reshape(-1, 2):
            low = np.array([x, y]) - side / 2 - self.origin
            i, j = np.round(low / self.resolution).astype(int)[::-1]
            n = max(1, round(side / self.resolution))
            occupied[max(i, 0) : max(i + n, 0), max(j, 0) : max(j + n, 0)] = True
        return FloorPlan(
            occupied, self.resolution, self.origin, self.start, self.measuring_points, self.walls, self.wall_thickness
        )

    def check(self, *, where: object = "floor plan", clearance: float = 0.3) -> None:
        """Raises `PlanError` unless start and measuring points are free and a robot of radius `clearance` [m] reaches
        them all from the start."""
        if not len(self.measuring_points):
            raise PlanError(
                "no point to measure at", where=where, key="measuring_points", valid="at least one x, y [m]"
            )
        free = self.clearance() > clearance
        regions, _ = label(free)
        points = np.vstack([self.start[:2], self.measuring_points])
        names = ["start", *(f"measuring_points[{i}]" for i in range(len(self.measuring_points)))]
        cells = self.cell_of(points)
        reached = 0
        for name, point, cell in zip(names, points, cells, strict=True):
            value = [round(float(x), 3) for x in point]
            if not ((cell >= 0) & (cell < free.shape)).all():
                x, y = self.origin + self.size
                extent = f"x in {self.origin[0]:g}..{x:g}, y in {self.origin[1]:g}..{y:g} m"
                raise PlanError("outside the plan", where=where, key=name, value=value, valid=extent)
            if self.occupied[tuple(cell)]:
                raise PlanError("inside a wall", where=where, key=name, value=value, valid="a free place")
            if not free[tuple(cell)]:
                valid = f"at least {clearance:g} m from walls"
                raise PlanError("too near to a wall", where=where, key=name, value=value, valid=valid)
            reached = reached or int(regions[tuple(cell)])
            if regions[tuple(cell)] != reached:
                raise PlanError("no way leads there from the start", where=where, key=name, value=value)


def plan_from_walls(
    walls: np.ndarray,
    size: np.ndarray,
    start: np.ndarray,
    measuring_points: np.ndarray,
    *,
    thickness: float = 0.2,
    resolution: float = 0.05,
    outlines: list[np.ndarray] | tuple[np.ndarray, ...] = (),
) -> FloorPlan:
    """Draws walls into a plan whose corner is the origin of W.

    Args:
        walls: (m, 2, 2) middle lines, from and to [m]. size: (2,) along x and y [m].
        outlines: closed polygons (k, 2) [m] that are filled.

    Raises:
        PlanError: the plan has no size or too many cells.
    """
    size = np.asarray(size, float)
    shape = tuple(int(n) for n in np.round(size[::-1] / resolution))
    if not np.isfinite(size).all() or min(shape) < 1 or math.prod(shape) > _MOST_CELLS:
        valid = f"1 to {_MOST_CELLS} cells"
        raise PlanError("no plan of that size", key="size", value=size.tolist(), valid=valid)
    walls = np.asarray(walls, float).reshape(-1, 2, 2)
    y, x = ((np.arange(n) + 0.5) * resolution for n in shape)
    occupied = np.zeros(shape, bool)
    for a, b in walls:
        length = float(np.hypot(*(b - a)))
        along = (b - a) / length if length else np.array([1.0, 0.0])
        reach = 0.5 * thickness * (np.abs(along) + np.abs(along[::-1])) + resolution
        low, high = np.minimum(a, b) - reach, np.maximum(a, b) + reach
        rows = slice(*np.searchsorted(y, [low[1], high[1]]))
        cols = slice(*np.searchsorted(x, [low[0], high[0]]))
        dx, dy = x[None, cols] - a[0], y[rows, None] - a[1]
        s, t = dx * along[0] + dy * along[1], dy * along[0] - dx * along[1]
        # Of a wall whose faces lie on middles of cells, one side's cells count.
        half = 0.5 * thickness + 1e-9
        occupied[rows, cols] |= (s >= -half) & (s < length + half) & (t >= -half) & (t < half)
    for outline in outlines:
        occupied |= _inside(np.asarray(outline, float), x, y)
    return FloorPlan(
        occupied, resolution, np.zeros(2), np.asarray(start, float), _points(measuring_points), walls, thickness
    )


def plan_from_image(
    path: Path,
    resolution: float | None,
    start: np.ndarray,
    measuring_points: np.ndarray,
    *,
    origin: np.ndarray | None = None,
    dark: float = 0.5,
) -> FloorPlan:
    """A plan from an image, upright as on paper: its lower edge is at the smallest y.

    Args:
        resolution: [m] of a pixel.
        origin: (2,) lower left corner in W [m]; 0, 0 by default.
        dark: [-] brightness below which a pixel is a wall, of 1.

    Raises:
        PlanError: the image cannot be read, or has no scale.
    """
    if resolution is None or not np.isfinite(resolution) or resolution <= 0:
        raise PlanError("a plan without scale", where=path, key="resolution", value=resolution, valid="> 0 m per pixel")
    try:
        with Image.open(path) as image:
            grey = np.asarray(image.convert("L"), float) / 255
    except (OSError, ValueError) as error:
        raise PlanError(f"cannot be read: {' '.join(str(error).split())}", where=path, valid="an image") from None
    corner = np.zeros(2) if origin is None else np.asarray(origin, float)
    return FloorPlan(
        np.ascontiguousarray(grey[::-1] < dark), resolution, corner, np.asarray(start, float), _points(measuring_points)
    )


def _points(points: np.ndarray) -> np.ndarray:
    return np.asarray(points, float).reshape(-1, 2)


def _inside(polygon: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(rows, cols) which middles of cells lie inside a polygon, by the even-odd rule."""
    inside = np.zeros((len(y), len(x)), bool)
    for (ax, ay), (bx, by) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        rows = (ay > y) != (by > y)
        if rows.any():
            crossing = ax + (y[rows] - ay) * (bx - ax) / (by - ay)
            inside[rows] ^= x[None, :] < crossing[:, None]
    return inside
