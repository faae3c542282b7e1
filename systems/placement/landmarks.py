"""Landmarks of a floor plan: corners and other places where walls that run in different directions meet (S4-a)."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label, maximum_filter, minimum_filter
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from ..config import check_config, quantity
from .floor_plan import FloorPlan
from .ray_kernels import sight_table
from .wall_kernels import wall_directions, wall_faces

HORIZONTAL, VERTICAL, RISING, FALLING = 1, 2, 3, 4
"""The paper's labels of wall points: along x, along y, slanting up to the right, up to the left."""


@dataclass(kw_only=True)
class LandmarkConfig:
    """What counts as a landmark, and from where it is seen."""

    # [m] Length of wall on either side of a point that says which way the wall runs there.
    window: float = quantity(0.3, unit="m", above=0)
    # [-] Least bend (0 straight, 0.3 a right angle) of a landmark: a wall that runs at 22.5° wavers between two labels,
    # and is none.
    min_bend: float = quantity(0.04, low=0, high=1)
    # [-] A bend from which on a point is a landmark also with one label: the end of a thin wall, whose faces have the
    # same.
    sharp_bend: float = quantity(0.15, low=0, high=1)
    # [m] Landmark points nearer than this are of the same landmark: the corners of a box of 0.5 m.
    merge_distance: float = quantity(0.6, unit="m", above=0)
    # [m] Range of the laser.
    laser_range: float = quantity(30.0, unit="m", above=0)
    # [m] Spacing of the places at which it is noted which landmarks are seen from there.
    view_spacing: float = quantity(0.5, unit="m", above=0)


@dataclass(frozen=True, eq=False)
class LandmarkMap:
    """Landmarks of a floor plan. Read-only.

    Attributes:
        positions: (n, 2) in W [m].
        extent: (n,) radius of the circle around the position that holds the landmark's points [m].
        labels: (rows, cols) uint8, label of every wall point, 0 where there is none.
        seen: (n, R, C) bool: from where each landmark is in the laser's range and in sight.
        view_spacing: side of a cell of `seen` [m]. origin: (2,) corner of its first cell in W [m].
    """

    positions: np.ndarray
    extent: np.ndarray
    labels: np.ndarray
    seen: np.ndarray
    view_spacing: float
    origin: np.ndarray

    def __deepcopy__(self, memo: dict) -> "LandmarkMap":
        return self

    def seen_from(self, points: np.ndarray) -> np.ndarray:
        """(k, n) which landmarks are seen from the cells of points (k, 2) [m]; none from outside the plan."""
        cells = np.floor((np.asarray(points, float) - self.origin) / self.view_spacing).astype(int)[:, ::-1]
        inside = ((cells >= 0) & (cells < self.seen.shape[1:])).all(axis=1)
        row, col = np.where(inside[:, None], cells, 0).T
        return self.seen[:, row, col].T & inside[:, None]


def reachable_cells(plan: FloorPlan) -> np.ndarray:
    """(rows, cols) free cells that are linked with the start; behind closed walls there is nothing to see."""
    regions, _ = label(~plan.occupied)
    start = regions[tuple(plan.cell_of(plan.start[:2]))]
    return (regions == start) & ~plan.occupied


def label_walls(plan: FloorPlan, window: float) -> tuple[np.ndarray, np.ndarray]:
    """Labels (rows, cols) uint8 of the wall points that can be seen, 0 elsewhere, and the walls' bend there.

    Args:
        window: see `LandmarkConfig`.
    """
    angle, bend = wall_directions(
        wall_faces(plan.occupied, reachable_cells(plan)), max(1, round(window / plan.resolution))
    )
    order = np.array([HORIZONTAL, RISING, VERTICAL, FALLING], np.uint8)
    quarter = np.round(np.nan_to_num(angle) / (np.pi / 4)).astype(int) % 4
    return np.where(np.isnan(angle), 0, order[quarter]).astype(np.uint8), bend


def find_landmarks(plan: FloorPlan, config: LandmarkConfig | None = None) -> LandmarkMap:
    """Finds the landmarks of a plan (S4-a; paper, section 3.1).

    Wall points are labelled by the direction in which the wall runs. A point is of a landmark when its label and those
    of its eight neighbours are of two kinds or more, and the wall bends there, or when it bends sharply. Points near
    each other are one landmark.

    Raises:
        ConfigError: a value of `config` is out of range.
    """
    config = config or LandmarkConfig()
    check_config(config, key="landmarks")
    labels, bend = label_walls(plan, config.window)
    walls = labels > 0
    most = maximum_filter(labels, 3, mode="constant")
    least = minimum_filter(np.where(walls, labels, 255), 3, mode="constant", cval=255)
    sharp = np.nan_to_num(bend) >= config.sharp_bend
    rows, cols = np.nonzero(walls & (sharp | ((most != least) & (np.nan_to_num(bend) >= config.min_bend))))
    points, weights = plan.centre_of(np.column_stack([rows, cols])), bend[rows, cols].astype(float)
    positions, extent = _merged(points, weights, config.merge_distance)
    stride = config.view_spacing
    shape = np.ceil(plan.size[::-1] / stride - 1e-9).astype(int)
    y, x = ((np.arange(n) + 0.5) * stride for n in shape)
    eyes = plan.origin + np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    free = ~plan.is_occupied(eyes)
    seen = np.zeros((len(positions), len(eyes)), bool)
    seen[:, free] = sees_landmarks(plan, eyes[free], positions, extent, config.laser_range).T
    return LandmarkMap(positions, extent, labels, seen.reshape(-1, *shape), stride, plan.origin)


def sees_landmarks(
    plan: FloorPlan, eyes: np.ndarray, positions: np.ndarray, extent: np.ndarray, reach: float
) -> np.ndarray:
    """(k, n) which landmarks are seen from `eyes` (k, 2) [m], by one ray to each.

    Args:
        positions: (n, 2) [m]. extent: (n,) how far before its position a landmark may be hit [m]. reach: [m].
    """
    table = np.zeros((len(eyes), len(positions)), bool)
    from_ = (np.asarray(eyes, float) - plan.origin) / plan.resolution
    to = (np.asarray(positions, float) - plan.origin) / plan.resolution
    for k in range(len(positions)):
        slack = extent[k] / plan.resolution + 2
        table[:, k] = sight_table(plan.occupied, from_, to[k : k + 1], slack, reach / plan.resolution)[:, 0]
    return table


def _merged(points: np.ndarray, weights: np.ndarray, distance: float) -> tuple[np.ndarray, np.ndarray]:
    """Means (n, 2) of points that are linked by steps of at most `distance`, and the radii that hold them."""
    if not len(points):
        return np.zeros((0, 2)), np.zeros(0)
    pairs = KDTree(points).query_pairs(distance, output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs)), pairs.T), (len(points), len(points)))
    count, member = connected_components(links, directed=False)
    total = np.bincount(member, weights, count)
    mean = np.column_stack([np.bincount(member, weights * points[:, k], count) / total for k in (0, 1)])
    away = np.hypot(*(points - mean[member]).T)
    radius = np.zeros(count)
    np.maximum.at(radius, member, away)
    return mean, radius
