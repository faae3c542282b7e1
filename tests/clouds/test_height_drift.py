"""Drift of the height is found from what was seen before."""

import numpy as np
import pytest
from naraha.systems.clouds import LocalCloudConfig
from naraha.systems.clouds.height_drift import height_offset
from naraha.systems.clouds.local_points import place_scan

AT_REST = (np.tile(np.eye(3), (1, 1, 1)), np.zeros((1, 3)))


def placed(points):
    keys, new = place_scan(points, np.ones(len(points)), AT_REST, np.zeros(3), LocalCloudConfig())
    order = np.argsort(keys, kind="stable")
    return keys[order], new[order]


def ground(rng, slope=0.0, noise=0.0, count=3000):
    xy = rng.uniform(-1.5, 1.5, (count, 2))
    return np.column_stack([xy, slope * xy[:, 0] + noise * rng.standard_normal(count)])


@pytest.mark.parametrize("slope", [0.0, 0.25])
@pytest.mark.parametrize("offset", [-0.06, 0.01, 0.05])
def test_the_offset_of_noisy_ground_is_found_to_millimetres(slope, offset):
    rng = np.random.default_rng(3)
    keys, old = placed(ground(rng, slope, 0.01))
    new_keys, new = placed(ground(rng, slope, 0.01, count=600) + np.array([0, 0, offset]))
    found = height_offset(keys, old[:, 2], np.zeros(len(keys)), new_keys, new[:, 2], before=1.0)
    assert found == pytest.approx(offset, abs=0.004)


def test_recent_points_walls_and_things_that_came_do_not_count():
    rng = np.random.default_rng(4)
    keys, old = placed(ground(rng))
    # A quarter of the ground is hidden by something 7 cm high: less than the limit, and still no reason to rise.
    new = ground(rng, count=600) + np.array([0, 0, 0.01])
    new[new[:, 0] > 0.75, 2] += 0.07
    new_keys, new = placed(new)
    assert height_offset(keys, old[:, 2], np.zeros(len(keys)), new_keys, new[:, 2], before=1.0) == pytest.approx(
        0.01, abs=0.003
    )
    assert height_offset(keys, old[:, 2], np.full(len(keys), 2.0), new_keys, new[:, 2], before=1.0) is None
    y, z = rng.uniform(-1.5, 1.5, 4000), rng.uniform(0, 1.4, 4000)
    wall_keys, wall = placed(np.column_stack([np.full(4000, 1.01), y, z]))
    assert height_offset(wall_keys, wall[:, 2], np.zeros(len(wall_keys)), wall_keys, wall[:, 2], before=1.0) is None
