import numpy as np
from naraha.systems.dose import voxel_shadow
from scipy import ndimage


def test_runs_and_gaps_along_an_axis_are_those_of_scipy():
    rng = np.random.default_rng(0)
    for _ in range(30):
        mask = np.pad(rng.random(rng.integers(1, 12, 3)) < rng.uniform(0.1, 0.9), 2)
        closed = voxel_shadow._eroded(voxel_shadow._dilated(mask, 3, 1), 3, 1)
        np.testing.assert_array_equal(closed, ndimage.binary_closing(mask, np.ones((1, 3, 1))))
        for run in (1, 2, 3, 6):
            opened = voxel_shadow._opened(mask, run, 2)
            np.testing.assert_array_equal(opened, ndimage.binary_opening(mask, np.ones((1, 1, run))))
