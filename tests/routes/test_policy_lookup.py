import numpy as np
from naraha.systems.routes import ACTIONS, RoutePolicy, RouteTask, looked_up, solve

from .maps import water_map
from .tasks import corridor


def test_the_table_says_what_to_do_and_nothing_at_the_goal():
    task, start = corridor()
    policy = RoutePolicy.of(task, solve(task).q)
    assert ACTIONS[looked_up(policy, start)] == "forward"
    assert ACTIONS[looked_up(policy, np.array([0.4, 0.6, np.pi]))] == "back"
    assert looked_up(policy, np.array([4.6, 0.9, 0.0])) == -1


def test_there_is_no_motion_off_the_table():
    task, _ = corridor()
    policy = RoutePolicy.of(task, solve(task).q)
    for pose in ([-1.0, 0.75, 0.0], [0.25, 0.2, 0.0], [np.nan, 0.75, 0.0]):
        assert looked_up(policy, np.array(pose)) == -1


def test_within_the_radius_of_the_goal_the_robot_is_there():
    grid, _, goal = water_map(0)
    task = RouteTask(grid, goal, goal_radius=0.5)
    policy = RoutePolicy.of(task, solve(task).q)
    away = grid.centre_of(np.argwhere(~grid.blocked)) - np.array(goal)
    for xy in away[np.hypot(*away.T) < 1.0] + np.array(goal):
        assert (looked_up(policy, np.array([*xy, 0.3])) == -1) == (np.hypot(*(xy - np.array(goal))) <= 0.5)
