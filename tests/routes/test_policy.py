import numpy as np
import pytest
from naraha.systems.errors import InputError
from naraha.systems.routes import (
    PolicyFileError,
    RewardConfig,
    RouteGrid,
    RoutePolicy,
    RouteTask,
    from_outcomes,
    paper_rewards,
    read_policy,
    roll_out,
    slipping,
    solve,
    write_policy,
)

from .maps import hall_map, maze_map, water_map
from .tasks import corridor


@pytest.fixture
def learnt():
    grid, start, goal = water_map(3, size=(24, 24))
    task = RouteTask(grid, goal)
    q = np.where(np.isfinite(solve(task).q), solve(task).q, 0.0)
    return task, task.state_of(start), RoutePolicy.of(task, q)


def test_the_table_is_looked_up_by_place_and_nearest_heading(learnt):
    task, start, policy = learnt
    pose = task.pose_of(np.array(start))
    best = int(policy.q.reshape(-1, 4)[start].argmax())
    assert policy.action_of(pose) == best
    assert policy.action_of(pose + np.array([0.09, -0.09, 0.35])) == best
    assert policy.action_of(pose + np.array([0, 0, 2 * np.pi])) == best


def test_the_table_says_nothing_where_nothing_was_learnt(learnt):
    task, _, policy = learnt
    water = np.argwhere(task.grid.blocked)[0]
    assert policy.action_of(np.append(task.grid.centre_of(water), 0.0)) is None
    assert policy.action_of(np.array([99.0, 0.0, 0.0])) is None
    assert policy.action_of(np.array([np.nan, 0.0, 0.0])) is None
    assert RoutePolicy.nothing(RewardConfig()).action_of(np.zeros(3)) is None


def test_a_roll_out_drives_over_free_cells_only_and_knows_its_length():
    task, start = corridor()
    route = roll_out(task, solve(task).q, task.state_of(start))
    assert route.reason == "goal"
    assert route.length == pytest.approx(4.5)
    assert route.actions.tolist() == [0] * 9
    assert len(route.poses) == 10


def test_a_drawn_roll_out_slips_and_still_arrives():
    grid, start, goal = hall_map(0)
    task = RouteTask(grid, goal, motion=slipping())
    q, s = solve(task).q, task.state_of(start)
    routes = [roll_out(task, q, s, rng=np.random.default_rng(k)) for k in range(5)]
    assert all(route.reached for route in routes)
    assert len({len(route.actions) for route in routes}) > 1


def test_a_motion_over_several_cells_ends_where_the_goal_is_met():
    task, start = corridor()
    leaps = from_outcomes({"flat": {"forward": [(1.0, 4, 0, 0)]}})
    far = RouteTask(task.grid, task.goal, task.rewards, leaps)
    route = roll_out(far, solve(far).q, far.state_of(start))
    assert route.actions.tolist() == [0, 0, 0]
    assert np.allclose(route.poses[-1, :2], task.goal)


@pytest.mark.parametrize("rewards", [RewardConfig(), paper_rewards()])
def test_what_is_written_is_read_back_exactly(tmp_path, rewards):
    grid, _, goal = maze_map(1)
    task = RouteTask(grid, goal, rewards, goal_radius=0.3)
    policy = RoutePolicy.of(task, np.where(np.isfinite(solve(task).q), solve(task).q, 0.0))
    write_policy(tmp_path / "policy.csv", policy)
    again = read_policy(tmp_path / "policy.csv", grid)
    assert np.array_equal(again.q[again.free], policy.q[policy.free])
    assert np.array_equal(again.free, policy.free)
    assert np.array_equal(again.origin, policy.origin)
    names = ("cell", "goal", "goal_radius", "rewards", "fingerprint")
    assert all(getattr(again, name) == getattr(policy, name) for name in names)


def test_a_policy_of_another_map_is_refused_by_name(tmp_path, learnt):
    task, _, policy = learnt
    path = tmp_path / "policy.csv"
    write_policy(path, policy)
    other = RouteGrid.from_kind(task.grid.kind, task.grid.cell, task.grid.origin + 0.2)
    with pytest.raises(PolicyFileError, match=r"policy\.csv: is for another map, got '24×24 cells.*valid: 24×24"):
        read_policy(path, other)
    assert read_policy(path).fingerprint == policy.fingerprint


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda text: "x,y\n1,2\n", "is not a policy"),
        (lambda text: "", "is not a policy"),
        (lambda text: text[: len(text) // 2], "is damaged"),
        (lambda text: text.replace('"cell_m": ', '"cell": '), "is damaged"),
        (lambda text: text.replace("\n1,1,0,", "\n99,1,0,"), "a cell outside the grid"),
        (lambda text: text.replace("\n1,1,0,", "\n1,1,spam,"), "is damaged"),
        (lambda text: text.replace('"discount"', '"spam"'), "is damaged"),
    ],
)
def test_a_damaged_file_is_refused(tmp_path, learnt, damage, words):
    path = tmp_path / "policy.csv"
    write_policy(path, learnt[2])
    path.write_text(damage(path.read_text()))
    with pytest.raises(PolicyFileError, match=words):
        read_policy(path)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(PolicyFileError, match=r"none\.csv: cannot be read"):
        read_policy(tmp_path / "none.csv")
    with pytest.raises(InputError, match="do not fit the grid"):
        RoutePolicy.of(corridor()[0], np.zeros((1, 1, 8, 4)))
