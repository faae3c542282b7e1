"""Surfels: the small planes that a cloud is made of."""

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from open3d.t.geometry import PointCloud

from .config import SurfacesConfig
from .grid_kernels import cell_means, sort_into_cells, within
from .sight_kernels import nearest_ranges
from .surfel_kernels import cloud_surfels, image_means, image_surfels

# Range images are reduced to about so many rows and columns by taking means: a finer one says no more about planes.
_ROWS, _COLUMNS = 32, 450
# [m] Points farther from the middle of their block are on something else.
BLOCK_GATE = 0.25
# Where a cell of the radius holds fewer points than this on average the radius is enlarged, so many times at most.
_CROWD, _WIDEST = 5.0, 2.0
# [m] Coordinates beyond do not fit the search grid.
_FARTHEST = 1e5


@dataclass(frozen=True, eq=False)
class Surfels:
    """Planes, as rows of `data` (N, 8).

    Attributes:
        data: position (3) [m], unit normal (3), variance of the normal's direction [rad²], and the number of
            neighbours it was laid through.
        probabilities: of the classes, (N, K), -1 where they are not known; K is 0 without classes.
        signed: normals point to the sensor, and so tell the two sides of a wall apart; else their sign is arbitrary.
        overlap: how many surfels share a neighbour, on average: so many times fewer are independent.
        clutter: points (M, 3) among many neighbours that make no plane: leaves, gravel; of clouds without rings.
        ranges: how far the sensor saw in every direction, see `nearest_ranges`; None for clouds without rings.
    """

    data: np.ndarray
    probabilities: np.ndarray
    signed: bool
    overlap: float
    clutter: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    ranges: np.ndarray | None = None

    @cached_property
    def centre(self) -> np.ndarray:
        """Mean position (3,)."""
        return self.data[:, :3].mean(axis=0) if len(self) else np.zeros(3)

    def __len__(self) -> int:
        return len(self.data)


def usable_points(cloud: PointCloud) -> np.ndarray:
    """Indices of the points of `cloud` that are finite and not absurdly far."""
    if "positions" not in cloud.point:
        return np.zeros(0, np.int64)
    points = cloud.point.positions.numpy()
    return np.flatnonzero(within(np.ascontiguousarray(points, np.float32), _FARTHEST))


def surfels_of(cloud: PointCloud, config: SurfacesConfig) -> Surfels:
    """Surfels of any cloud, about one each `spacing`.

    With the attributes `ring` and `column` it is a range image, where returns may be missing, seen from the origin of
    its frame or from near it: neighbours are taken from several rings, because those on one ring lie on a line and say
    nothing of the tilt across it. Any other cloud is thinned to means, and neighbours are those within the radius, a
    larger one in a sparse cloud. Where they do not make a plane there is no surfel: at edges, at clutter, and along a
    single line. Points are laid on their planes.
    """
    usable = usable_points(cloud)
    if len(usable) == 0:
        return Surfels(np.zeros((0, 8)), np.zeros((0, 0)), False, 1.0)
    points = np.ascontiguousarray(cloud.point.positions.numpy()[usable], np.float32)
    organised = is_organised(cloud)
    if organised:
        row, column = (cloud.point[name].numpy().ravel()[usable].astype(np.int32) for name in ("ring", "column"))
        clutter = np.zeros((0, 3))
        data, which, members, ranges = _image_surfels(points, row, column, config)
    else:
        ranges = None
        data, which, members, clutter = _cloud_surfels(points, _weights(cloud)[usable], config)
    probabilities = np.zeros((len(data), 0))
    if config.classes and "class_probabilities" in cloud.point:
        probabilities = cloud.point["class_probabilities"].numpy()[usable][which].astype(float)
        probabilities[~np.isfinite(probabilities).all(axis=1)] = -1.0
    return Surfels(data, probabilities, organised, max(1.0, data[:, 7].sum() / members), clutter, ranges)


def is_organised(cloud: PointCloud) -> bool:
    """Whether the points have their row and column in a range image."""
    return "ring" in cloud.point and "column" in cloud.point


def block_shape(row: np.ndarray, column: np.ndarray) -> tuple[int, int, int, int]:
    """Height and width of the blocks that a range image is reduced to [pixels], and their rows and columns."""
    height, width = max(1, round((row.max() + 1) / _ROWS)), max(1, round((column.max() + 1) / _COLUMNS))
    return height, width, math.ceil((row.max() + 1) / height), math.ceil((column.max() + 1) / width)


def _weights(cloud: PointCloud) -> np.ndarray:
    """The root of how many points each point of `cloud` is the mean of.

    Where a wall runs along a border of voxels, the few on its far side must not count as much as the many on its near
    side; but were the many near the sensor to count in full, few of them would make a plane.
    """
    if "count" not in cloud.point:
        return np.ones(len(cloud.point.positions))
    return np.sqrt(np.maximum(cloud.point["count"].numpy().reshape(-1).astype(float), 1.0))


def _image_surfels(
    points: np.ndarray, row: np.ndarray, column: np.ndarray, config: SurfacesConfig
) -> tuple[np.ndarray, np.ndarray, int, np.ndarray]:
    height, width, rows, columns = block_shape(row, column)
    means, counts, middle = image_means(points, row, column, rows, columns, height, width, BLOCK_GATE)
    data, which = image_surfels(means, counts, middle, config.radius, config.widening, config.spacing, config.thickness)
    return data, which, int(np.count_nonzero(counts)), nearest_ranges(means[counts > 0])


def _cloud_surfels(
    points: np.ndarray, weights: np.ndarray, config: SurfacesConfig
) -> tuple[np.ndarray, np.ndarray, int, np.ndarray]:
    means, counts, first = cell_means(points, weights, config.grain)
    radius = config.radius
    keys, ends, order, cells = sort_into_cells(means, radius)
    if len(means) < _CROWD * cells:
        radius *= min(math.sqrt(_CROWD * cells / len(means)), _WIDEST)
        keys, ends, order, cells = sort_into_cells(means, radius)
    centres = np.sort(cell_means(means, counts, config.spacing)[2])
    data, which, clutter = cloud_surfels(means, counts, centres, keys, ends, order, radius, config.thickness)
    return data, first[which], len(means), means[clutter]
