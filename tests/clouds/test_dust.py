"""Dust in a ring of shots at a wall, with a pole before it."""

import numpy as np
import open3d as o3d
import pytest
from naraha.systems.clouds.dust import without_dust
from naraha.systems.sensing import Scan
from open3d.t.geometry import PointCloud

DUST = [40, 41, 200, 300]


def ring(**attributes):
    angles = np.deg2rad(np.arange(-90, 90, 0.5))
    ranges = np.full(len(angles), 4.0)
    ranges[100:104] = 2.0
    ranges[DUST] = [0.5, 3.0, 1.0, 3.7]
    cloud = PointCloud(
        np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles), 0 * angles]).astype(np.float32)
    )
    columns = np.arange(len(angles))[:, None]
    for name, values in ({"ring": 0 * columns, "column": columns} | attributes).items():
        if values is not None:
            cloud.point[name] = o3d.core.Tensor(values.astype(np.uint16))
    return Scan(cloud, 0.0, 0.1, 0)


def test_single_shots_go_and_what_was_shot_twice_stays():
    scan = ring()
    left = without_dust(scan, 0.1).attribute("column")
    assert sorted(set(range(len(scan.p_SP))) - set(left)) == DUST


@pytest.mark.parametrize("name", ["ring", "column"])
def test_a_scan_that_does_not_say_which_shot_is_which_stays_as_it_is(name):
    scan = ring(**{name: None})
    assert without_dust(scan, 0.1) is scan


def test_without_points_there_is_no_dust():
    scan = ring()
    none = Scan(scan.cloud_S.select_by_mask(o3d.core.Tensor(np.zeros(len(scan.p_SP), bool))), 0.0, 0.1, 0)
    assert len(without_dust(none, 0.1).p_SP) == 0
