"""What a look at the ground would tell: how uncertain it still is whether there is water."""

import numpy as np
from open3d.t.geometry import PointCloud
from scipy.ndimage import distance_transform_edt
from scipy.special import entr

from ..hazards.classes import WATER
from ..hazards.water import cloud_attribute, cloud_points
from .gaps import close_gaps
from .route_grid import RouteGrid


def make_interest(
    cloud: PointCloud,
    grid: RouteGrid,
    *,
    prior: float = 0.1,
    height: float = 0.15,
    suspicion: float = 5.0,
    max_gap: float = 0.4,
) -> np.ndarray:
    """What a look at each cell of `grid` would tell [bit], (nx, ny) float32.

    It is the entropy of whether there is water, H(p) = −p log₂ p − (1 − p) log₂ (1 − p): near 0 where near-infrared has
    seen dry ground or water, or where LiDAR shots speak for dry ground. Where they speak for water and no camera has
    looked, a look counts `suspicion` times: what hides there is small and closes ways. So it does in the gaps between
    such cells, for water sends few shots back; but not beside a puddle that has been found, whose rest it is. Ground of
    which nothing has told is worth 1, seen or not.

    Args:
        cloud: semantic map in M, with `water_probability`, `nir` and `label` if known.
        prior: of water; twice as much is a suspicion.
        height: points this near to the ground of a cell are ground [m]. max_gap: widest gap that is closed, and how far
            from the points of a puddle the rest of it lies [m].
    """
    points, water = cloud_points(cloud), cloud_attribute(cloud, "water_probability")
    usable = np.isfinite(water)
    usable[usable] = grid.contains(points[usable, :2])
    looked = np.isfinite(cloud_attribute(cloud, "nir"))[usable]
    found = cloud_attribute(cloud, "label")[usable] == WATER.id
    points, water = points[usable], water[usable]
    cells = tuple(grid.index_of(points[:, :2]).T) if len(points) else (np.zeros(0, int), np.zeros(0, int))
    with np.errstate(invalid="ignore"):
        ground = np.abs(points[:, 2] - grid.height[cells]) < height
    puddle = np.zeros(grid.shape, bool)
    puddle[cells[0][found], cells[1][found]] = True
    beside = distance_transform_edt(~puddle) * grid.cell <= max_gap if puddle.any() else puddle
    suspicious = ~looked & (water > 2 * prior) & ~beside[cells]
    worth = entropy(water) * np.where(suspicious, suspicion, 1.0)
    told = np.full(grid.shape, -np.inf)
    np.maximum.at(told, (cells[0][ground], cells[1][ground]), worth[ground])
    told = np.where(np.isfinite(told), told, 1.0)
    doubted, answered = np.zeros(grid.shape, bool), np.zeros(grid.shape, bool)
    for mask, which in ((doubted, suspicious), (answered, looked)):
        mask[cells[0][ground & which], cells[1][ground & which]] = True
    between = close_gaps(doubted, max_gap, grid.cell) & ~doubted & ~answered
    if between.any():
        told[between] = np.maximum(told[between], told[doubted].mean())
    return told.astype(np.float32)


def entropy(p: np.ndarray) -> np.ndarray:
    """Of a choice with probability `p` [bit]."""
    return np.asarray((entr(p) + entr(1 - p)) / np.log(2))
