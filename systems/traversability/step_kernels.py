"""Compiled search for steps: heights that change where the ground on both sides does not."""

import numpy as np
from numba import njit


@njit(cache=True)
def _common(before: float, after: float) -> float:
    """The slope that the ground has on both sides: the smaller one, 0 where they differ in sign or one is not known."""
    if before * after > 0.0:  # False for NaN
        return before if abs(before) < abs(after) else after
    return 0.0


@njit(cache=True)
def _unexplained(rise: float, cells: int, before: float, after: float, steepest: float) -> float:
    """What of a rise over so many cells neither the slope before it nor the one after it makes, if it is a ramp's."""
    least = abs(rise)
    for slope in (before, after):
        if abs(slope) <= steepest:  # False for NaN
            least = min(least, abs(rise - cells * slope))
    return least


@njit(cache=True)
def cell_steps(low: np.ndarray, high: np.ndarray, cell: float, gap: int, gap_slope: float, noise: float) -> np.ndarray:
    """Largest step at every cell (nx, ny) [m], within it or to the next one that was seen; NaN where it was not seen.

    Cells are compared with the next two along x and y that were seen, `gap` cells away at most: the edge of a riser is
    smeared over two. What goes on as the slope before or after it is a ramp and no step, up to `gap_slope`; so is
    what the cells in between, if they were not seen, could hide. `noise` [m] is taken off.
    """
    nx, ny = low.shape
    middle = 0.5 * (low + high)
    step = np.full((nx, ny), np.nan, np.float32)
    for i in range(nx):
        for j in range(ny):
            if not np.isfinite(low[i, j]):
                continue
            rise = 0.0
            for axis in range(2):
                di, dj = 1 - axis, axis
                slope = _common(
                    _difference(middle, i - 2 * di, j - 2 * dj, di, dj), _difference(middle, i + di, j + dj, di, dj)
                )
                rise += abs(slope)
            step[i, j] = max(high[i, j] - low[i, j] - rise - noise, 0.0)
    for i in range(nx):
        for j in range(ny):
            if not np.isfinite(low[i, j]):
                continue
            for axis in range(2):
                di, dj = 1 - axis, axis
                seen = 0
                for g in range(1, gap + 1):
                    p, q = i + g * di, j + g * dj
                    if p >= nx or q >= ny:
                        break
                    if not np.isfinite(low[p, q]):
                        continue
                    before = _difference(middle, i - di, j - dj, di, dj)
                    after = _difference(middle, p, q, di, dj)
                    height = _unexplained(middle[p, q] - middle[i, j], g, before, after, gap_slope * cell)
                    height -= gap_slope * cell * (g - 1 - seen) + noise
                    step[i, j], step[p, q] = max(step[i, j], height), max(step[p, q], height)
                    seen += 1
                    if seen == 2:
                        break
    return step


@njit(cache=True)
def _difference(z: np.ndarray, i: int, j: int, di: int, dj: int) -> float:
    """From cell (i, j) to the next one; NaN outside."""
    if i < 0 or j < 0 or i + di >= z.shape[0] or j + dj >= z.shape[1]:
        return np.nan
    return z[i + di, j + dj] - z[i, j]
