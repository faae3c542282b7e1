from dataclasses import replace

import numpy as np
import pytest
from naraha.models.plans import load_floor_plan, shipped_plans
from naraha.models.worlds import BUILDERS, load_world
from naraha.models.worlds.halls import HallConfig, build_hall, hang_lamps, snapped
from naraha.systems.errors import ConfigError
from naraha.systems.placement import plan_from_walls

PLAN = plan_from_walls(
    np.array([[[0.1, 0.1], [7.9, 0.1]], [[7.9, 0.1], [7.9, 5.9]], [[7.9, 5.9], [0.1, 5.9]], [[0.1, 5.9], [0.1, 0.1]]]),
    np.array([8.0, 6.0]),
    np.array([1.0, 1.0, 0.0]),
    np.array([[6.0, 4.0]]),
)


def ranges(world, eye, angles):
    directions = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))])
    return world.ray_scene().cast(np.array(eye), directions).distance


def test_walls_stand_where_the_plan_draws_them():
    angles = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    eye = np.array([3.0, 2.0])
    seen = eye + ranges(build_hall(PLAN), [*eye, 0.34], angles)[:, None] * np.column_stack(
        [np.cos(angles), np.sin(angles)]
    )
    # Just before every hit the plan is free, just behind it is occupied.
    along = (seen - eye) / np.linalg.norm(seen - eye, axis=1)[:, None]
    assert not PLAN.is_occupied(seen - 1e-3 * along).any()
    assert PLAN.is_occupied(seen + 1e-3 * along).all()


def test_boxes_stand_where_the_plan_draws_them():
    sites = np.array([[4.013, 3.031], [6.0, 1.5]])
    drawn = PLAN.with_boxes(sites, 0.5)
    world = build_hall(PLAN, sites)
    boxes = [solid for solid in world.solids if solid.name.startswith("landmark")]
    assert len(boxes) == 2
    new = drawn.occupied & ~PLAN.occupied
    cells = drawn.centre_of(np.argwhere(new))
    inside = [np.abs(cells - np.array(box.xyz[:2])).max(axis=1) < 0.25 for box in boxes]
    assert (inside[0] ^ inside[1]).all()
    np.testing.assert_array_equal([mask.sum() for mask in inside], [100, 100])
    assert all(box.xyz[2] - box.box[2] / 2 == pytest.approx(0) for box in boxes)
    assert np.abs(snapped(PLAN, sites, 0.5) - sites).max() <= 0.025 + 1e-9


def test_lamps_hang_in_rows_over_free_floor():
    config = HallConfig(lamp_spacing=2.0, lamp_height=4.0, lamp_intensity=500.0)
    lamps = hang_lamps(PLAN, config)
    assert len(lamps) == 12
    places = np.array([lamp.xyz for lamp in lamps])
    assert not PLAN.is_occupied(places[:, :2]).any()
    np.testing.assert_array_equal(np.unique(places[:, 0]), [1, 3, 5, 7])
    assert (places[:, 2] == 4.0).all()
    intensities = np.array([lamp.intensity for lamp in hang_lamps(PLAN, replace(config, lamp_spacing=0.2), seed=4)])
    assert intensities.mean() == pytest.approx(500.0, rel=0.02)
    assert intensities.std() == pytest.approx(50.0, rel=0.1)
    even = hang_lamps(PLAN, replace(config, lamp_spread=0.0))
    assert {lamp.intensity for lamp in even} == {500.0}
    assert build_hall(PLAN, config=HallConfig(lamps=lamps[:2])).lamps == lamps[:2]


@pytest.mark.parametrize("name", shipped_plans())
def test_every_shipped_plan_is_a_world_with_light(name):
    assert name in BUILDERS
    world, plan = load_world(name, 0), load_floor_plan(name)
    assert world.lamps
    assert not any(solid.name.startswith("landmark") for solid in world.solids)
    # A ray from the start meets a wall of the plan.
    distance = ranges(world, [*plan.start[:2], 0.34], np.array([plan.start[2]]))
    assert 0.3 < distance[0] < np.hypot(*plan.size)


def test_values_out_of_range_are_refused():
    with pytest.raises(ConfigError, match=r"hall\.box_side: out of range"):
        build_hall(PLAN, config=HallConfig(box_side=0.0))
