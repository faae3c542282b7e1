import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from naraha.systems.errors import InputError
from naraha.systems.routes import GridRouteVectorEnv, RouteTask, slipping, solve
from naraha.systems.routes.grid_route import example_task

from .maps import water_map
from .tasks import corridor

NAME = "naraha/GridRoute-v0"


@pytest.fixture
def spread():
    grid, start, goal = water_map(0)
    return RouteTask(grid, goal, motion=slipping(0.2, 0.2)), start


def test_gymnasium_finds_nothing_wrong(spread):
    check_env(gym.make(NAME).unwrapped)
    check_env(gym.make(NAME, task=spread[0], start=spread[1]).unwrapped)


def test_the_optimal_policy_gets_its_value_and_ends_at_the_goal():
    task, start = example_task()
    env, q = gym.make(NAME), solve(task).q
    observation, info = env.reset(seed=0)
    assert np.allclose(info["pose"], start)
    total, ended = 0.0, False
    while not ended:
        observation, reward, ended, truncated, info = env.step(int(q[tuple(observation)].argmax()))
        total += reward
        assert not truncated
    assert info["reached"]
    assert total == pytest.approx(solve(task).value.flat[task.state_of(start)])


def test_the_outcomes_come_as_often_as_the_model_says(spread):
    task, start = spread
    env = gym.make(NAME, task=task, start=start)
    env.reset(seed=1)
    stayed = 0
    for _ in range(2000):
        env.reset()
        _, _, _, _, info = env.step(0)
        stayed += info["state"] == task.state_of(start)
    assert stayed / 2000 == pytest.approx(0.2, abs=0.03)


def test_the_same_seed_gives_the_same_run_and_another_does_not(spread):
    def run(seed):
        env = gym.make(NAME, task=spread[0], start=spread[1])
        env.reset(seed=seed)
        rng = np.random.default_rng(0)
        return [env.step(int(a))[4]["state"] for a in rng.integers(0, 4, 60)]

    assert run(3) == run(3)
    assert run(3) != run(4)


def test_an_episode_is_truncated_not_terminated_after_its_motions():
    env = gym.make(NAME)
    env.reset(seed=0)
    for k in range(2000):
        _, _, terminated, truncated, _ = env.step(2)
        assert not terminated
        assert truncated == (k == 1999)


def test_a_start_can_be_given_for_one_episode():
    env = gym.make(NAME)
    pose = np.array([3.25, 4.25, np.pi / 2])
    assert np.allclose(env.reset(options={"start": pose})[1]["pose"], pose)
    assert not np.allclose(env.reset()[1]["pose"], pose)
    with pytest.raises(InputError, match="in a cell that is water"):
        env.reset(options={"start": np.array([6.0, 6.0, 0.0])})
    with pytest.raises(InputError, match="at the goal already"):
        env.reset(options={"start": np.array([11.25, 6.25, 0.0])})


def test_a_task_without_a_start_is_refused():
    with pytest.raises(InputError, match="needs a start"):
        gym.make(NAME, task=example_task()[0])


def test_the_batch_does_what_single_robots_do():
    task, start = corridor(per_metre=0.1, per_turn=0.03)
    batch = gym.make_vec(NAME, num_envs=3, task=task, start=start)
    assert isinstance(batch.unwrapped, GridRouteVectorEnv)
    single = gym.make(NAME, task=task, start=start)
    batch.reset(seed=0)
    single.reset(seed=0)
    for _ in range(9):
        observations, rewards, terminated, _, _ = batch.step(np.array([0, 2, 1]))
        observation, reward, ended, _, _ = single.step(0)
        assert np.array_equal(observations[0], observation)
        assert rewards[0] == pytest.approx(reward)
        assert terminated.tolist() == [ended, False, False]
    assert ended
    # The next step begins the first robot's next episode, whatever the action.
    observations, rewards, terminated, _, _ = batch.step(np.array([0, 2, 1]))
    assert observations[0].tolist() == [0, 1, 0]
    assert rewards[0] == 0
    assert not terminated.any()


def test_the_batch_truncates_each_robot_by_its_own_count(spread):
    batch = GridRouteVectorEnv(2, *spread, most_motions=5)
    batch.reset(seed=0)
    truncations = [batch.step(np.array([2, 3]))[3].tolist() for _ in range(12)]
    assert [any(t) for t in truncations] == [k in (4, 10) for k in range(12)]


def test_the_batch_draws_outcomes_as_often_as_the_model_says(spread):
    batch = GridRouteVectorEnv(4000, *spread)
    batch.reset(seed=0)
    observations = batch.step(np.zeros(4000, int))[0]
    assert (observations == batch.reset()[0]).all(axis=1).mean() == pytest.approx(0.2, abs=0.03)
    with pytest.raises(InputError, match="not actions"):
        batch.step(np.full(4000, 4))
