import numpy as np
import pytest
import scipy.sparse as sp
from naraha.systems.routes import (
    FREE,
    OCCUPIED,
    LearningConfig,
    RewardConfig,
    RouteGrid,
    RouteTask,
    expected_motions,
    expected_sum,
    optimality_gap,
    paper_rewards,
    roll_out,
    slipping,
    solve,
)
from naraha.systems.routes.q_learning import start_values
from scipy.sparse.csgraph import dijkstra

from .maps import fenced, hall_map, maze_map, water_map
from .tasks import corridor

REWARDS = [RewardConfig(), paper_rewards(), RewardConfig(per_metre=0.0, per_turn=0.0, discount=0.97)]


def test_the_value_of_a_straight_way_is_its_length_and_turns():
    task, start = corridor(per_metre=0.1, per_turn=0.03)
    value = solve(task).value
    assert value.flat[task.state_of(start)] == pytest.approx(1 - 9 * 0.5 * 0.1)
    assert value.flat[task.state_of(start + np.array([0, 0, np.pi / 2]))] == pytest.approx(1 - 4.5 * 0.1 - 2 * 0.03)
    # Facing away, it is cheaper to drive backwards than to turn.
    assert value.flat[task.state_of(start + np.array([0, 0, np.pi]))] == pytest.approx(1 - 4.5 * 0.1)


def test_with_a_discount_the_value_is_a_power_of_the_motions():
    task, start = corridor(per_metre=0.0, per_turn=0.0, discount=0.1)
    assert solve(task).value.flat[task.state_of(start)] == pytest.approx(0.1**8)


def test_a_chance_of_failure_costs_what_it_says():
    task, start = corridor(per_metre=0.1, per_turn=0.03)
    slow = RouteTask(task.grid, task.goal, task.rewards, slipping(slip=0.2, veer=0.0))
    # Each of 9 steps fails 0.25 times on average, at the price of a turn.
    assert solve(slow).value.flat[slow.state_of(start)] == pytest.approx(1 - 0.45 - 9 * 0.25 * 0.03)
    actions = solve(slow).q.reshape(-1, 4).argmax(axis=1)
    assert expected_motions(slow, actions, slow.state_of(start)) == pytest.approx(9 * 1.25)


def test_running_into_water_costs_five_and_stays_where_it_was():
    grid, _, goal = water_map(0)
    task = RouteTask(grid, goal)
    successor, reward = task.transitions
    beside = next(
        (i, j) for i, j in np.argwhere(grid.kind == FREE) if grid.kind[i + 1, j] == 2 and not task.goal_cells[i, j]
    )
    s = (beside[0] * grid.shape[1] + beside[1]) * 8
    assert successor[s, 0, 0] == s
    assert reward[s, 0, 0] == pytest.approx(-5 - task.rewards.per_turn)


def test_corners_are_not_cut():
    kind = fenced(6, 6)
    kind[3, 2] = OCCUPIED
    task = RouteTask(RouteGrid.from_kind(kind, 1.0), (3.5, 3.5))
    s = task.state_of(np.array([2.5, 2.5, np.pi / 4]))  # the goal is one diagonal step ahead, past a corner
    assert task.transitions[0][s, 0, 0] == s


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("make", [hall_map, maze_map])
def test_the_optimum_is_that_of_dijkstra_on_the_same_motions(seed, make):
    grid, _, goal = make(seed, (20, 16) if make is hall_map else (4, 4))
    rng = np.random.default_rng(seed)
    grid = RouteGrid.from_kind(grid.kind, grid.cell, grid.origin, cost=rng.uniform(1, 3, grid.shape))
    task = RouteTask(grid, goal)
    successor, reward = task.transitions
    loss = np.full((task.states + 1, task.states + 1), np.inf)  # the last node is the goal
    for s, a in np.ndindex(successor.shape[:2]):
        n = int(successor[s, a, 0])
        loss[n, s] = min(loss[n, s], (task.rewards.goal if n < 0 else 0.0) - reward[s, a, 0])
    np.fill_diagonal(loss, np.inf)
    graph = sp.csr_matrix(np.where(np.isfinite(loss), loss, 0.0))
    expected = task.rewards.goal - dijkstra(graph, indices=task.states)[:-1]
    got = solve(task).value.ravel().copy()
    free = np.repeat(~grid.blocked.ravel() & ~task.goal_cells.ravel(), 8)
    assert np.allclose(got[free], expected[free], atol=1e-9)


@pytest.mark.parametrize("rewards", REWARDS)
@pytest.mark.parametrize("motion", [None, slipping()])
def test_the_values_solve_bellmans_equation(rewards, motion):
    grid, _, goal = hall_map(3)
    task = RouteTask(grid, goal, rewards, **({} if motion is None else {"motion": motion}))
    solution = solve(task)
    successor, reward = task.transitions
    value = np.append(solution.value.ravel(), 0.0)
    known = np.isfinite(value[:-1]) & ~np.repeat(task.goal_cells.ravel(), 8)
    q = (task.motion.probability[0] * (reward[known] + rewards.discount * value[successor[known]])).sum(axis=2)
    assert np.allclose(q, solution.q.reshape(-1, 4)[known], rtol=1e-9, atol=0)
    assert np.allclose(q.max(axis=1), value[:-1][known], rtol=1e-5, atol=1e-300)


@pytest.mark.parametrize("rewards", REWARDS)
@pytest.mark.parametrize("motion", [None, slipping()])
def test_the_bounds_are_never_below_the_optimum(rewards, motion):
    for seed in range(3):
        grid, _, goal = hall_map(seed)
        task = RouteTask(grid, goal, rewards, **({} if motion is None else {"motion": motion}))
        value = solve(task).value.max(axis=2)
        away = np.isfinite(value) & ~task.goal_cells
        for bound in (task.bound, task.straight_bound):
            assert (bound[away] >= value[away] * (1 - 1e-6) - 1e-9 * (rewards.discount == 1)).all()
        assert (task.straight_bound[away] >= task.bound[away] * (1 - 1e-6)).all()


def test_the_optimum_has_no_gap_and_its_roll_out_earns_its_value():
    grid, start, goal = maze_map(2)
    task = RouteTask(grid, goal)
    s, solution = task.state_of(start), solve(task)
    assert optimality_gap(task, solution.q, s, solution) == pytest.approx(0, abs=1e-9)
    route = roll_out(task, solution.q, s)
    assert route.reached
    assert route.rewards.sum() == pytest.approx(solution.value.flat[s])
    assert np.allclose(route.poses[-1, :2], goal)


def test_a_policy_that_goes_in_circles_has_an_infinite_gap():
    task, start = corridor()
    q = np.zeros(task.q_shape)
    q[..., 2] = 1.0  # always turns left
    s = task.state_of(start)
    assert optimality_gap(task, q, s, solve(task)) == np.inf
    assert roll_out(task, q, s).reason == "circle"
    assert expected_sum(task, np.full(task.states, 2), s) == -np.inf


def test_a_detour_shows_as_a_gap_of_its_size():
    task, start = corridor(per_metre=0.1, per_turn=0.03)
    s, solution = task.state_of(start), solve(task)
    q = solution.q.copy()
    q[1, 1, 0] = [0, 0, 1, 0]  # once on the way: turn left,
    q[1, 1, 1] = [0, 0, 0, 1]  # and back,
    q[2, 1, 0] = [1, 0, 0, 0]
    assert optimality_gap(task, q, s, solution) == np.inf  # for ever
    q[1, 1, 1] = [0, 0, 1, 0]
    for heading in range(2, 8):
        q[1, 1, heading] = [0, 0, 1, 0] if heading != 4 else [0, 1, 0, 0]
        q[2, 1, heading] = [0, 0, 1, 0]
    # Four turns in cell 1 and backwards out of it, four in cell 2 to face ahead again.
    assert optimality_gap(task, q, s, solution) == pytest.approx(8 * 0.03 / 0.45)


def test_where_no_way_leads_the_value_says_so():
    grid, start, goal = water_map(1, "none")
    task = RouteTask(grid, goal)
    assert not task.can_reach(task.state_of(start))
    assert solve(task).value.flat[task.state_of(start)] == -np.inf
    assert np.isfinite(start_values(task, LearningConfig().start_values)).all()
