"""From points to the surface of the ground."""

import numpy as np
import pytest
from naraha.systems.traversability import find_surface

from tests.traversability.grounds import ground, plane, pole

ORIGIN, SHAPE, CELL = np.array([-2.0, -2.0]), (40, 40), 0.1


def surface(points, **options):
    return find_surface(points, ORIGIN, SHAPE, CELL, **options)


def at(cells, x, y):
    i, j = np.floor((np.array([x, y]) - cells.origin) / cells.cell).astype(int)
    return float(cells.low[i, j]), float(cells.high[i, j])


def test_flat_ground_is_flat_and_all_of_it_is_seen():
    cells = surface(ground(plane(0)))
    assert cells.seen.all()
    assert np.abs(cells.low).max() < 0.04
    assert (cells.high >= cells.low).all()


def test_a_stray_point_makes_no_height_and_a_thin_pole_does():
    points = ground(plane(0), noise=0.0)
    stray = np.array([[0.55, 0.55, 0.8], [-0.55, 0.55, -0.8]], np.float32)
    cells = surface(np.vstack([points, stray, pole((1.05, -0.55))]))
    assert at(cells, 0.55, 0.55) == (0.0, 0.0)
    assert at(cells, -0.55, 0.55) == (0.0, 0.0)
    assert at(cells, 1.05, -0.55)[1] > 0.4


def test_a_single_point_counts_where_its_neighbours_agree():
    around = [[0.15, 0.05, 0.02], [0.05, 0.15, 0.0]]
    assert at(surface(np.array([[0.05, 0.05, 0.0], *around])), 0.05, 0.05) == (0.0, 0.0)
    assert np.isnan(at(surface(np.array([[0.05, 0.05, 0.5], *around])), 0.05, 0.05)[0])
    assert np.isnan(at(surface(np.array([[0.05, 0.05, 0.0]])), 0.05, 0.05)[0])


def test_what_hangs_above_the_robot_is_not_ground():
    points = ground(plane(0), noise=0.0)
    beam = ground(plane(0, height=1.5), seed=1, points=5000, reach=0.5, noise=0.0)
    cells = surface(np.vstack([points, beam]), clearance=1.0)
    assert cells.high.max() == 0.0
    low = surface(np.vstack([points, beam - np.float32([0, 0, 0.8])]), clearance=1.0)
    assert low.high.max() == pytest.approx(0.7)


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.full((50, 3), np.nan), np.full((50, 3), 1e9)])
def test_nothing_usable_is_nothing_seen(points):
    assert not surface(points).seen.any()
