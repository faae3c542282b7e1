"""What a look at the ground would tell."""

import numpy as np
import open3d as o3d
import pytest
from naraha.systems.hazards.classes import WATER
from naraha.systems.routes import RouteGrid
from naraha.systems.routes.interest import entropy, make_interest
from open3d.t.geometry import PointCloud

GRID = RouteGrid.from_kind(np.zeros((20, 20), np.uint8), 0.1)


def ground(cells, water, *, nir=np.nan, z=0.0):
    """A point in each cell (i, j), with probability of water and brightness in near-infrared."""
    cells = np.asarray(cells)
    xyz = np.column_stack([(cells + 0.5) * 0.1, np.full(len(cells), z)]).astype(np.float32)
    cloud = PointCloud(o3d.core.Tensor(xyz))
    for name, value in (("water_probability", water), ("nir", nir)):
        cloud.point[name] = o3d.core.Tensor(np.full((len(cells), 1), value, np.float32))
    return cloud


def test_ground_is_worth_the_entropy_of_whether_it_is_water():
    assert make_interest(ground([[3, 3]], 0.02), GRID)[3, 3] == pytest.approx(entropy(np.array(0.02)), rel=1e-5)
    assert make_interest(ground([[3, 3]], 1.0, nir=50.0), GRID)[3, 3] == 0
    # No point tells anything of the next cell.
    assert make_interest(ground([[3, 3]], 0.02), GRID)[10, 10] == 1


def test_a_suspicion_counts_more_until_a_camera_has_looked():
    blind, looked = (make_interest(ground([[3, 3]], 0.5, nir=nir), GRID)[3, 3] for nir in (np.nan, 50.0))
    assert blind == pytest.approx(5.0)
    assert looked == pytest.approx(1.0)


def test_what_stands_over_the_ground_says_nothing_about_it():
    assert make_interest(ground([[3, 3]], 0.5, z=0.5), GRID)[3, 3] == 1


def test_suspicion_spreads_over_the_gaps_of_a_pool_but_not_over_what_a_camera_saw_dry():
    ring = [(i, j) for i in range(6, 11) for j in range(6, 11) if {i, j} & {6, 10}]
    suspected = ground(ring, 0.5)
    assert make_interest(suspected, GRID)[8, 8] == pytest.approx(5.0)
    assert make_interest(suspected, GRID)[13, 8] == 1
    answered = suspected.append(ground([[8, 8]], 0.0, nir=50.0))
    assert make_interest(answered, GRID)[8, 8] == 0
    assert make_interest(answered, GRID)[8, 7] == pytest.approx(5.0)


def test_the_rest_of_a_puddle_that_has_been_found_is_no_new_suspicion():
    rest, elsewhere = ground([[3, 3]], 0.5), ground([[15, 15]], 0.5)
    puddle = ground([[3, 6]], 0.9, nir=50.0)
    for cloud, label in ((rest, 0), (elsewhere, 0), (puddle, WATER.id)):
        cloud.point["label"] = o3d.core.Tensor(np.full((1, 1), label, np.uint8))
    worth = make_interest(rest.append(elsewhere).append(puddle), GRID)
    assert worth[3, 3] == pytest.approx(1.0)
    assert worth[15, 15] == pytest.approx(5.0)
