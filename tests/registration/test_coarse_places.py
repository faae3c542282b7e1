"""Descriptors by which a place is recognised."""

import numpy as np
import pytest
from naraha.systems.registration.coarse import View, describe_place, place_distance
from pydrake.math import RigidTransform

from tests.benchmarks.registration_scenes import PLACES, Flat, yaw_pose
from tests.rooms import make_cloud


def test_a_turn_and_a_shift_of_the_sensor_change_little():
    flat, rng = Flat(2), np.random.default_rng(0)
    here = flat.scan(yaw_pose(5, 4, 0.6, 0.0), rng)
    turned = flat.scan(yaw_pose(5, 4, 0.6, 2.2), rng)
    beside = flat.scan(yaw_pose(5.8, 4.6, 0.6, -1.3), rng)
    elsewhere = flat.scan(yaw_pose(-8, -4, 0.6, 0.0), rng)
    first, *others = (describe_place(cloud) for cloud in (here, turned, beside, elsewhere))
    distances = place_distance(first, np.stack(others))
    assert first.dtype == np.float32
    assert first.shape == (384,)
    assert distances[0] < 0.7 * distances[2]
    assert distances[1] < 0.9 * distances[2]


def test_revisits_rank_before_other_places():
    flat, rng = Flat(3), np.random.default_rng(1)

    def described(x, y):
        X = RigidTransform(yaw_pose(x, y, 0.6, rng.uniform(-3, 3), *rng.uniform(-0.05, 0.05, 2)))
        return describe_place(View(flat.scan(X, rng)))

    first = np.stack([described(x, y) for x, y in PLACES])
    # 0.8 to 1 m to the side, where it is still free.
    again = np.stack([described(x + 0.8 * np.cos(k), y + 0.8 * np.sin(k)) for k, (x, y) in enumerate(PLACES)])
    nearest = np.array([place_distance(place, first).argmin() for place in again])
    assert (nearest == np.arange(len(PLACES))).mean() >= 0.8


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.full((100, 3), np.nan)])
def test_nothing_has_a_descriptor_of_zeros(points):
    assert not describe_place(make_cloud(points)).any()
