"""What a look at the ground would tell: how uncertain it still is whether there is water."""

import numpy as np
from open3d.t.geometry import PointCloud
from scipy.special import entr

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

    Where there is ground it is the entropy of whether it is water, H(p) = −p log₂ p − (1 − p) log₂ (1 − p): near 0
    where near-infrared has seen dry ground or water, some 0.2 where only LiDAR shots speak for dry ground. Where they
    speak for water and no camera has looked, a look counts `suspicion` times: what hides there is small and closes
    ways. So it does in the gaps between such cells, for water sends few shots back. Unknown ground is worth 1.

    Args:
        cloud: semantic map in M, with `water_probability` and `nir` if known.
        prior: of water, where neither LiDAR nor camera has told anything.
        height: points this near to the ground of a cell are ground [m]. max_gap: widest gap that is closed [m].
    """
    interest = np.ones(grid.shape, np.float32)
    interest[np.isfinite(grid.height)] = entropy(np.array([prior]))[0]
    points, water = cloud_points(cloud), cloud_attribute(cloud, "water_probability")
    usable = np.isfinite(water)
    usable[usable] = grid.contains(points[usable, :2])
    looked = np.isfinite(cloud_attribute(cloud, "nir"))[usable]
    points, water = points[usable], water[usable]
    cells = tuple(grid.index_of(points[:, :2]).T) if len(points) else (np.zeros(0, int), np.zeros(0, int))
    with np.errstate(invalid="ignore"):
        ground = np.abs(points[:, 2] - grid.height[cells]) < height
    suspicious = ~looked & (water > 2 * prior)
    worth = entropy(water) * np.where(suspicious, suspicion, 1.0)
    told = np.full(grid.shape, -np.inf)
    np.maximum.at(told, (cells[0][ground], cells[1][ground]), worth[ground])
    told = np.where(np.isfinite(told), told, interest)
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
