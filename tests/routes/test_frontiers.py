from dataclasses import replace

import numpy as np
import pytest
from naraha.systems.errors import ConfigError, InputError
from naraha.systems.routes import FREE, OCCUPIED, RouteGrid, Voxels
from naraha.systems.routes.frontiers import (
    FrontierConfig,
    View,
    find_goals,
    gain_of,
    hiding_cells,
    open_questions,
    seen_cells,
)

CONFIG = FrontierConfig(view_range=2.0, near_range=0.0, fov_deg=90, min_gain=0.5, min_value=0.0)


def hall(nx=80, ny=50):
    """A hall of 8 m × 5 m within walls; what hides is what is blocked."""
    kind = np.full((nx, ny), FREE, np.uint8)
    kind[[0, -1]] = kind[:, [0, -1]] = OCCUPIED
    return kind


def goals_in(kind, pose=(1.0, 1.0, 0.0), views=(), config=CONFIG, interest=None):
    grid = RouteGrid.from_kind(kind, 0.1)
    return find_goals(grid, np.array(pose), kind == OCCUPIED, views, config, interest=interest)


def test_one_look_covers_its_sector_and_nothing_behind_walls():
    kind = hall()
    kind[30, 10:40] = OCCUPIED
    seen = seen_cells(RouteGrid.from_kind(kind, 0.1), kind == OCCUPIED, [View(2.05, 2.5, 0.0)], CONFIG)
    centres = RouteGrid.from_kind(kind, 0.1).centre_of(np.argwhere(seen))
    away = centres - [2.05, 2.5]
    assert (np.linalg.norm(away, axis=1) <= 2.0 + 0.1).all()
    assert (np.abs(np.arctan2(away[:, 1], away[:, 0]))[np.linalg.norm(away, axis=1) > 0.2] < np.pi / 4 + 0.4).all()
    assert centres[:, 0].max() < 3.0


def test_the_area_of_a_look_over_open_ground_is_that_of_its_sector():
    goal = goals_in(hall(), pose=(4.0, 2.5, 0.0))[0]
    assert goal.gain == pytest.approx(np.pi * 2.0**2 / 4, rel=0.06)


def test_looking_at_the_best_goal_again_and_again_sees_the_hall_and_ends():
    kind = hall()
    kind[20:25, 20:50] = OCCUPIED
    grid, pose, views = RouteGrid.from_kind(kind, 0.1), np.array([1.0, 1.0, 0.0]), []
    while goals := goals_in(kind, pose, views):
        view = goals[0].view
        views.append(view)
        pose = np.array([view.x, view.y, view.heading])
        assert len(views) < 60
    seen = seen_cells(grid, kind == OCCUPIED, views, CONFIG)
    assert seen[kind == FREE].mean() > 0.9


def test_a_suspicion_that_a_look_from_afar_did_not_answer_is_asked_from_near_and_only_once():
    kind = hall()
    interest = np.zeros(kind.shape, np.float32)
    interest[40:44, 23:27] = 5.0
    config = replace(CONFIG, view_range=4.0, sure_range=1.5)
    grid, hiding = RouteGrid.from_kind(kind, 0.1), kind == OCCUPIED
    far, near = View(1.0, 2.5, 0.0), View(3.0, 2.5, 0.0)

    def gain(view, *views):
        return gain_of(view, open_questions(grid, hiding, views, interest, config), grid, hiding, config)

    whole = pytest.approx(5.0 * 0.4 * 0.4)
    assert (gain(far), gain(near)) == (whole, whole)
    assert (gain(far, far), gain(near, far)) == (0, whole)
    assert (gain(far, near), gain(near, near)) == (0, 0)
    goal = goals_in(kind, (1.0, 2.5, 0.0), [far], config=replace(config, room=0.2), interest=interest)[0]
    assert np.hypot(goal.view.x - 4.2, goal.view.y - 2.5) < 1.6
    interest[interest > 0] = 0.9
    assert gain(near, far) == 0


def test_what_cannot_be_reached_is_no_goal():
    kind = hall()
    kind[40, :] = OCCUPIED
    assert all(goal.view.x < 4.0 for goal in goals_in(kind))


def test_places_to_look_from_leave_the_robot_room_to_turn():
    kind = hall()
    kind[30, :22] = kind[30, 28:] = OCCUPIED
    grid = RouteGrid.from_kind(kind, 0.1)
    goals = goals_in(kind, pose=(1.0, 2.5, 0.0), config=replace(CONFIG, room=0.4))
    room = [grid.clearance[tuple(grid.index_of(np.array([goal.view.x, goal.view.y])))] for goal in goals]
    assert min(room) >= 0.4
    assert max(goal.view.x for goal in goals) > 3.5


def test_a_look_that_was_taken_is_not_proposed_again():
    goal = goals_in(hall())[0]
    again = goals_in(hall(), views=[goal.view])
    assert all(other.view != goal.view for other in again)


def test_goals_are_ordered_by_value():
    values = [goal.value for goal in goals_in(hall())]
    assert values == sorted(values, reverse=True)


def test_only_what_stands_at_the_height_of_the_cameras_hides():
    grid = RouteGrid.from_kind(hall(), 0.1)
    voxels = Voxels(np.array([[10, 10, 0], [20, 20, 5], [30, 30, 20]]), np.ones(3, np.uint8), 0.1)
    assert np.argwhere(hiding_cells(grid, voxels, CONFIG)).tolist() == [[20, 20]]


def test_a_pose_in_a_wall_is_named():
    with pytest.raises(InputError, match="occupied"):
        goals_in(hall(), pose=(0.05, 1.0, 0.0))


def test_a_view_without_width_is_refused():
    with pytest.raises(ConfigError, match="fov_deg"):
        goals_in(hall(), config=FrontierConfig(fov_deg=0))
