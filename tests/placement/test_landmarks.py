"""Landmarks: corners of any wall, none on straight ones, small things are one, seen where nothing is in between."""

import numpy as np
import pytest
from naraha.systems.placement import LandmarkConfig, find_landmarks
from naraha.systems.placement.landmarks import FALLING, HORIZONTAL, RISING, VERTICAL, label_walls
from scipy.spatial import KDTree

from .halls import hall, lines

CORNERS = np.array([[0.2, 0.2], [35.8, 0.2], [0.2, 15.8], [35.8, 15.8]])


def test_a_bare_hall_has_its_four_corners():
    found = find_landmarks(hall())
    assert len(found.positions) == 4
    assert KDTree(found.positions).query(CORNERS)[0].max() < 0.2


def test_walls_are_labelled_by_direction():
    plan = hall(np.concatenate([lines((6, 4), (10, 8)), lines((20, 8), (24, 4))]))
    labels, _ = label_walls(plan, 0.3)
    probes = {HORIZONTAL: (18, 0.5), VERTICAL: (0.5, 8), RISING: (8, 6), FALLING: (22, 6)}
    for expected, (x, y) in probes.items():
        row, col = plan.cell_of(np.array([x, y]))
        near = labels[row - 5 : row + 6, col - 5 : col + 6]
        assert expected in near
        assert set(np.unique(near)) <= {0, expected}


@pytest.mark.parametrize("degrees", [0, 10, 22.5, 35, 45, 67.5])
def test_a_straight_wall_has_landmarks_at_its_ends_alone(degrees):
    along = 4 * np.array([np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))])
    ends = np.array([18.0, 8.0]) + np.outer([-1, 1], along)
    found = find_landmarks(hall(ends[None], resolution=0.05))
    inner = found.positions[KDTree(CORNERS).query(found.positions)[0] > 0.5]
    assert len(inner) == 2
    assert KDTree(inner).query(ends)[0].max() < 0.25


def test_a_box_is_one_landmark_in_its_middle():
    plan = hall().with_boxes(np.array([[18.0, 8.0]]))
    found = find_landmarks(plan)
    assert len(found.positions) == 5
    assert KDTree(found.positions).query([18.0, 8.0])[0] < 0.1


def test_landmarks_are_seen_within_range_and_not_through_walls():
    plan = hall(lines((12, 0.1), (12, 9)))
    found = find_landmarks(plan, LandmarkConfig(laser_range=8.0))
    corner = int(KDTree(found.positions).query([0.2, 0.2])[1])
    end = int(KDTree(found.positions).query([12, 9])[1])
    seen = found.seen_from(np.array([[3.0, 3.0], [3.0, 9.0], [7, 6], [15, 6], [18, 3], [-5, 3]]))
    assert seen[:, corner].tolist() == [True, False, False, False, False, False]
    assert seen[:, end].tolist() == [False, False, True, True, False, False]
    assert not find_landmarks(plan, LandmarkConfig(laser_range=30.0)).seen_from(np.array([[13.5, 2]]))[0, corner]


def test_what_is_behind_closed_walls_is_no_landmark():
    room = lines((16, 6), (20, 6), (20, 10), (16, 10), (16, 6))
    positions = find_landmarks(hall(room)).positions
    inner = positions[np.abs(positions - [18, 8]).max(axis=1) < 3]
    assert len(inner) == 4
    assert (np.abs(inner - [18, 8]).max(axis=1) > 1.9).all()
