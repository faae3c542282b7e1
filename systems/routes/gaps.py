"""Gaps in a mask of cells."""

import numpy as np
from scipy.ndimage import binary_closing


def close_gaps(mask: np.ndarray, width: float, cell: float) -> np.ndarray:
    """`mask` (nx, ny) bool with gaps up to `width` [m] filled, for cells of edge `cell` [m]."""
    reach = int(np.ceil(0.5 * width / cell - 1e-9))
    if reach <= 0 or not mask.any():
        return mask
    span = np.arange(-reach, reach + 1)
    disc = span[:, None] ** 2 + span**2 <= (0.5 * width / cell + 0.5) ** 2
    return np.asarray(binary_closing(np.pad(mask, reach), disc)[reach:-reach, reach:-reach])
