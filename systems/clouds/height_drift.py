"""How far the height of a scan is off from what was seen before: drift that is found before it makes steps."""

import numpy as np
from numba import njit

from .local_points import KEY_BITS

# [m] A remembered column that is higher than this is a face or a wall, whose points say nothing of height.
_GROUND = 0.1
# Fewer common columns than this say nothing.
_FEW = 30


def height_offset(
    keys: np.ndarray, z: np.ndarray, time: np.ndarray, new_keys: np.ndarray, new_z: np.ndarray, *, before: float
) -> float | None:
    """Median height of new points over remembered ones in the same column of voxels [m]; None with too few.

    A lone column lies in the tilt of the ground and in the noise; the median of many is good to millimetres, and
    things that have come or gone do not move it. Columns that are farther off than 0.1 m do not count.

    Args:
        keys, z, time: of remembered points, sorted by key, (N,): key of the voxel, height [m] and time [s].
        new_keys, new_z: of the new ones, (M,).
        before: only what was measured before this time counts [s].
    """
    differences = _differences(keys, z, time, new_keys, new_z, before)
    return float(np.median(differences)) if len(differences) >= _FEW else None


@njit(cache=True)
def _differences(
    keys: np.ndarray, z: np.ndarray, time: np.ndarray, new_keys: np.ndarray, new_z: np.ndarray, before: float
) -> np.ndarray:
    result = np.empty(len(new_keys), np.float32)
    count = 0
    for n in range(len(new_keys)):
        first = (new_keys[n] >> KEY_BITS) << KEY_BITS
        low, high, nearest = np.inf, -np.inf, np.inf
        i = np.searchsorted(keys, first)
        while i < len(keys) and keys[i] < first + (1 << KEY_BITS):
            low, high = min(low, z[i]), max(high, z[i])
            if time[i] <= before and abs(new_z[n] - z[i]) < abs(nearest):
                nearest = new_z[n] - z[i]
            i += 1
        if high - low <= _GROUND and abs(nearest) <= _GROUND:
            result[count] = nearest
            count += 1
    return result[:count]
