"""The grid as a graph: slopes of its ground, steps that may be made, what they cost."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from .motion_model import STEPS
from .route_config import RoutesConfig
from .route_grid import RouteGrid


@dataclass(frozen=True, eq=False)
class Ground:
    """Arrays over the cells of a grid; read-only.

    Attributes:
        weight: (nx, ny) float64, cost of a way of one metre.
        moves: (nx, ny, 8) bool: which of `STEPS` may be made from each cell.
        slope: (nx, ny, 2) gradient of the smoothed height.
        height: (nx, ny) smoothed [m], NaN where nothing around is known.
    """

    weight: np.ndarray
    moves: np.ndarray
    slope: np.ndarray
    height: np.ndarray


def smoothed_height(height: np.ndarray, sigma: float) -> np.ndarray:
    """Heights averaged over neighbours that are known, weights a Gaussian of `sigma` cells; NaN far from all."""
    known = np.isfinite(height)
    share = gaussian_filter(known.astype(float), sigma, truncate=3, mode="constant")
    total = gaussian_filter(np.where(known, height, 0.0).astype(float), sigma, truncate=3, mode="constant")
    smooth = np.full(height.shape, np.nan)
    np.divide(total, share, out=smooth, where=share > 1e-3)
    return smooth


def make_ground(grid: RouteGrid, config: RoutesConfig) -> Ground:
    """Prepares a grid for the search.

    A diagonal step needs both cells beside it, so that no corner is cut. A step onto ground steeper than `max_pitch`
    along it or `max_roll` across it is left out. Cells near obstacles cost more, see `comfort`.
    """
    # What stands beside the way must not tilt it.
    floor = np.where(grid.blocked, np.nan, grid.height)
    smooth = smoothed_height(floor, 0.4 * config.slope_length / grid.cell)
    slope = np.zeros((*grid.shape, 2))
    for axis in range(2):
        if grid.shape[axis] > 1:
            slope[..., axis] = np.nan_to_num(np.gradient(smooth, grid.cell, axis=axis), nan=0.0)
    room = np.clip(grid.clearance / max(config.comfort, 1e-9), 0.0, 1.0)
    weight = grid.cost * (1 + (config.comfort_factor - 1) * (1 - room))
    free = np.pad(~grid.blocked, 1)
    nx, ny = grid.shape
    moves = np.zeros((nx, ny, 8), bool)
    flat = free[1:-1, 1:-1]
    for a, (dx, dy) in enumerate(STEPS):
        ahead, beside, other = (free[1 + i : 1 + i + nx, 1 + j : 1 + j + ny] for i, j in ((dx, dy), (dx, 0), (0, dy)))
        unit = np.array([dx, dy]) / np.hypot(dx, dy)
        along, across = slope @ unit, slope @ np.array([-unit[1], unit[0]])
        fits = (np.abs(along) <= np.tan(config.max_pitch)) & (np.abs(across) <= np.tan(config.max_roll))
        there = np.pad(fits, 1)[1 + dx : 1 + dx + nx, 1 + dy : 1 + dy + ny]
        moves[..., a] = flat & ahead & beside & other & fits & there
    return Ground(np.ascontiguousarray(weight, float), moves, slope, smooth)
