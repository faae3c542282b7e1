import numpy as np
import pytest
from naraha.systems.errors import ConfigError
from naraha.systems.snake.posture import nearest_by_half
from naraha.systems.snake.range_sensors import HalfShape, RangeSensorsConfig, zone_rays

from tests.snake.stuck_snake import settled

SHAPE = HalfShape(length=0.09, belly=0.015, side=0.055)


def test_zones_lie_along_the_half_and_look_down_and_to_both_sides():
    origin, direction = zone_rays(SHAPE, 3)
    np.testing.assert_allclose(origin[0], [[-0.015, 0, -0.015], [-0.045, 0, -0.015], [-0.075, 0, -0.015]])
    np.testing.assert_allclose(direction[:, 0], [[0, 0, -1], [0, 1, 0], [0, -1, 0]])
    np.testing.assert_allclose(origin[1:, :, 1], [[0.055] * 3, [-0.055] * 3])


def test_on_flat_ground_the_belly_sees_its_clearance_and_the_sides_nothing():
    _, run = settled(1, 0, stuck=False)
    nearest = nearest_by_half(run.read("station.ranges"), 10)
    far = nearest[[0, 1, 2, 17, 18, 19]]  # away from the plate
    np.testing.assert_allclose(far[:, 0], 0.035, atol=0.005)
    np.testing.assert_allclose(far[:, 1:], 0.3)


def test_posts_beside_the_body_are_seen_where_they_are():
    case, run = settled(3, 0)
    nearest = nearest_by_half(run.read("station.ranges"), 10)
    both = nearest[:, 1:].max(axis=1)
    assert both.min() < 0.012
    assert abs((np.argmin(both) + 1) // 2 - case.unit) <= 1


def test_values_out_of_range_are_refused():
    with pytest.raises(ConfigError, match=r"ranges\.zones"):
        settled(1, 0, ranges=RangeSensorsConfig(zones=0))
