import numpy as np
import pytest
from naraha.systems.errors import InputError
from naraha.systems.routes import (
    LearningConfig,
    RouteGrid,
    RoutePolicy,
    RouteTask,
    advance,
    begin,
    learn,
    optimality_gap,
    paper_rewards,
    reuse_values,
    roll_out,
    solve,
)

from .maps import hall_map, water_map
from .tasks import corridor


def solved(task):
    return RoutePolicy.of(task, np.where(np.isfinite(solve(task).q), solve(task).q, 0.0))


def episodes_to_the_goal(task, start, config, q=None, most=2000):
    """Episodes until the best motions lead from the start to the goal."""
    learning = begin(task, start, config, q=q)
    while learning.episodes < most and not roll_out(task, learning.q, start).reached:
        learning = advance(task, learning, config, 10**6, most_episodes=learning.episodes + 1)
    return learning.episodes


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("rewards", [None, paper_rewards()])
def test_the_policy_of_the_same_task_needs_no_more_learning(seed, rewards):
    grid, start, goal = hall_map(seed)
    task = RouteTask(grid, goal) if rewards is None else RouteTask(grid, goal, rewards)
    q = reuse_values(task, [solved(task)])
    assert optimality_gap(task, q, task.state_of(start), solve(task)) == pytest.approx(0, abs=1e-9)


def test_a_goal_of_several_cells_is_the_goal_in_all_of_them():
    grid, start, goal = hall_map(0)
    task = RouteTask(grid, goal, goal_radius=0.5)
    assert task.goal_cells.sum() > 4
    q = reuse_values(task, [solved(task)], start_values="straight")
    assert optimality_gap(task, q, task.state_of(start), solve(task)) == pytest.approx(0, abs=1e-9)


def test_a_policy_is_used_at_its_place_in_the_map_not_in_its_grid():
    grid, start, goal = hall_map(2)
    small = RouteGrid.from_kind(grid.kind[2:, 1:], grid.cell, grid.origin + np.array([2, 1]) * grid.cell)
    earlier = solved(RouteTask(small, goal))
    task = RouteTask(grid, goal)
    s = task.state_of(start)
    assert roll_out(task, reuse_values(task, [earlier]), s).reached
    assert not roll_out(task, reuse_values(task, []), s).reached


@pytest.mark.parametrize("seed", range(6))
def test_a_goal_nearby_needs_a_tenth_of_the_episodes(seed):
    grid, start, goal = water_map(seed)
    task = RouteTask(grid, goal)
    earlier = RouteTask(grid, (goal[0] - 0.4, goal[1] + 0.2))
    s = task.state_of(start)
    learned = learn(earlier, begin(earlier, earlier.state_of(start), seed=seed)).learning
    config = LearningConfig(anywhere=0.0, start_values="zero")
    q = reuse_values(task, [RoutePolicy.of(earlier, learned.q)])
    assert episodes_to_the_goal(task, s, config, q) <= episodes_to_the_goal(task, s, config) / 10


def test_a_policy_that_does_not_know_the_goal_adds_nothing():
    grid, _, goal = hall_map(1)
    task = RouteTask(grid, goal)
    far = RouteGrid.from_kind(np.zeros((10, 10)), 0.2, (50.0, 50.0))
    elsewhere = solved(RouteTask(far, (51.0, 51.0)))
    assert np.array_equal(reuse_values(task, [elsewhere]), reuse_values(task, []))


def test_values_of_other_rewards_are_refused():
    task, _ = corridor()
    other = RouteTask(task.grid, task.goal, paper_rewards())
    with pytest.raises(InputError, match="policy for other rewards"):
        reuse_values(task, [solved(other)])
