"""Points of one class grouped into regions with an outline and an area."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_fill_holes, label
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from ..config import quantity

_SIDES = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]])


@dataclass(kw_only=True)
class RegionConfig:
    """How points are grouped."""

    # [m] Edge of the square cells that are counted; not below the distance between the points.
    cell: float = quantity(0.1, unit="m", above=0.0)
    # [m] Cells up to this far apart, from centre to centre, belong together.
    reach: float = quantity(0.25, unit="m", above=0.0)
    # [m²] Regions smaller than this in plan are dropped.
    min_area: float = quantity(0.04, unit="m²", low=0.0)
    # [points] Regions of fewer points are dropped.
    min_points: int = quantity(4, unit="points", low=1)


@dataclass(frozen=True, eq=False)
class Region:
    """A patch of points of one class. Read-only.

    Attributes:
        label: its class, such as "water".
        p_MC: centre, the mean of its points, (3,) [m].
        area: in plan [m²].
        outline_M: corners of a simple polygon around it in plan, counterclockwise, not closed, (K, 2) [m].
        probability: mean over its points.
        points: their number.
        low_M, high_M: corners of the box around them, (3,) [m].
    """

    label: str
    p_MC: np.ndarray
    area: float
    outline_M: np.ndarray
    probability: float
    points: int
    low_M: np.ndarray
    high_M: np.ndarray

    def __deepcopy__(self, memo: dict) -> "Region":
        return self


@dataclass(frozen=True, eq=False)
class HotSpot(Region):
    """A hot region.

    Attributes:
        max_temperature, mean_temperature: over its points [°C].
    """

    max_temperature: float
    mean_temperature: float


def group_points(points: np.ndarray, cell: float, reach: float) -> np.ndarray:
    """Number of the group of every point, (N,): cells that hold points are joined when centres are within `reach`.

    Args:
        points: finite, (N, 2) to group in plan or (N, 3) in space [m].
        cell: edge of a cell [m].
    """
    if not len(points):
        return np.zeros(0, int)
    cells, owner = np.unique(np.floor(points / cell).astype(np.int64), axis=0, return_inverse=True)
    pairs = KDTree(cells).query_pairs(reach / cell * (1 + 1e-9), output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), (len(cells), len(cells)))
    return connected_components(graph, directed=False)[1][owner.ravel()]


def find_regions(
    points: np.ndarray,
    probability: np.ndarray,
    config: RegionConfig,
    *,
    name: str,
    threshold: float = 0.5,
    in_space: bool = False,
) -> list[tuple[Region, np.ndarray]]:
    """Groups the points whose probability is above `threshold`.

    The area is that of the cells, each counted with the share of its points that are positive: so a cell that the
    edge runs through counts with the part that is inside, and the area has no bias as long as points lie on both
    sides of the edge; around a thing in the air whole cells count. Cells without any point that a region encloses
    belong to it.

    Args:
        points: all points, positive or not, (N, 3) [m].
        probability: (N,); NaN, not known, is neither positive nor counted in a share.
        in_space: connect points in space; otherwise in plan.

    Returns:
        Regions, the largest first, each with the indices of its points.
    """
    points, probability = np.asarray(points, float).reshape(-1, 3), np.asarray(probability, float).ravel()
    known = np.isfinite(points).all(axis=1) & np.isfinite(probability)
    with np.errstate(invalid="ignore"):
        chosen = np.flatnonzero(known & (probability > threshold))
    group = group_points(points[chosen] if in_space else points[chosen, :2], config.cell, config.reach)
    others = points[known & ~(probability > threshold)]
    found = []
    order = np.argsort(group, kind="stable")
    for members in np.split(chosen[order], np.flatnonzero(np.diff(group[order])) + 1):
        if len(members) < config.min_points:
            continue
        inside = points[members]
        low, high = inside.min(axis=0), inside.max(axis=0)
        near = others[(np.abs(others - (low + high) / 2) <= (high - low) / 2 + config.cell).all(axis=1)]
        area, outline = _plan_view(inside[:, :2], near[:, :2], config.cell)
        if area >= config.min_area:
            mean = float(probability[members].mean())
            region = Region(name, inside.mean(axis=0), area, outline, mean, len(members), low, high)
            found.append((region, members))
    return sorted(found, key=lambda pair: -pair[0].area)


def _plan_view(inside: np.ndarray, others: np.ndarray, cell: float) -> tuple[float, np.ndarray]:
    """Area [m²] and outline of the cells that hold points (N, 2), given the points (M, 2) that are not part of it."""
    index = np.floor(inside / cell).astype(int)
    first = index.min(axis=0) - 1
    shape = index.max(axis=0) - first + 2
    index -= first
    positive = np.zeros(shape)
    np.add.at(positive, tuple(index.T), 1.0)
    other = np.floor(others / cell).astype(int) - first
    other = other[((other >= 0) & (other < shape)).all(axis=1)]
    negative = np.zeros(shape)
    np.add.at(negative, tuple(other.T), 1.0)
    share = positive / np.maximum(positive + negative, 1.0)
    enclosed = binary_fill_holes(positive > 0) & (positive + negative == 0)
    area = float(share.sum() + enclosed.sum()) * cell**2
    # An edge cell belongs to the outline when most of it is inside; all of a thin region is edge.
    mask = (share >= 0.5) | enclosed
    return area, (trace_outline(mask if mask.any() else positive > 0) + first) * cell


def trace_outline(mask: np.ndarray) -> np.ndarray:
    """Corners of one simple polygon around the cells of `mask`, counterclockwise, (K, 2) in cells; holes are filled.

    Its corners are the middles of the cells' edges on the boundary, so that a staircase becomes a slope. Parts that
    only touch at a corner, or not at all, are joined by a path of cells first.
    """
    mask = np.pad(binary_fill_holes(_joined(mask)), 1)
    # Edges with the inside on the left: start corner and direction, by the side of the cell on which they are.
    sides: Sequence[tuple[tuple[int, int], tuple[int, int], tuple[int, int]]] = (
        ((0, -1), (0, 0), (1, 0)),
        ((1, 0), (1, 0), (0, 1)),
        ((0, 1), (1, 1), (-1, 0)),
        ((-1, 0), (0, 1), (0, -1)),
    )
    edges: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for (dx, dy), (cx, cy), direction in sides:
        neighbour = np.roll(mask, (-dx, -dy), axis=(0, 1))
        for x, y in np.argwhere(mask & ~neighbour).tolist():
            edges.setdefault((x + cx, y + cy), []).append(direction)
    start = min(edges)  # on the outer boundary, with one edge, towards +x
    corner, heading = start, (1, 0)
    middles: list[tuple[float, float]] = []
    while not middles or corner != start:
        # Where two cells touch at a corner, turn left: stay on this cell.
        left = (-heading[1], heading[0])
        heading = left if left in edges[corner] else edges[corner][0]
        middles.append((corner[0] + heading[0] / 2, corner[1] + heading[1] / 2))
        corner = (corner[0] + heading[0], corner[1] + heading[1])
    outline = np.array(middles)
    back, ahead = outline - np.roll(outline, 1, axis=0), np.roll(outline, -1, axis=0) - outline
    return outline[back[:, 0] * ahead[:, 1] != back[:, 1] * ahead[:, 0]] - 1


def _joined(mask: np.ndarray) -> np.ndarray:
    """`mask` with its parts joined across edges, each to the nearest other by the shortest path of cells."""
    mask = mask.copy()
    while True:
        parts, count = label(mask, _SIDES)
        if count <= 1:
            return mask
        here, there = np.argwhere(parts == 1), np.argwhere(parts > 1)
        distance, nearest = KDTree(there).query(here)
        a = here[np.argmin(distance)]
        b = there[nearest[np.argmin(distance)]]
        mask[min(a[0], b[0]) : max(a[0], b[0]) + 1, a[1]] = True
        mask[b[0], min(a[1], b[1]) : max(a[1], b[1]) + 1] = True
