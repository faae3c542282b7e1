import copy

import numpy as np
import pytest
from naraha.systems.errors import ConfigError, InputError
from naraha.systems.routes import (
    LearningConfig,
    RewardConfig,
    RouteTask,
    advance,
    begin,
    learn,
    learn_many,
    paper_learning,
    paper_rewards,
    roll_out,
    slipping,
    solve,
)
from naraha.systems.routes import q_learning as module

from .maps import hall_map, water_map
from .tasks import corridor


def same(a, b):
    names = ("q", "visits", "curve_motions", "curve_rewards", "counters", "earned", "rng")
    return all(np.array_equal(getattr(a, n), getattr(b, n)) for n in names) and a.steps == b.steps


def test_one_update_is_equation_8():
    task, start = corridor(length=3, per_metre=0.0, per_turn=0.0, discount=0.9)
    s = task.state_of(start)
    q = np.zeros(task.q_shape)
    q[0, 1, 0] = [0.4, 0, 0, 0]  # forward is best
    q[1, 1, 0] = [0.0, 0.8, 0.0, 0.0]
    config = LearningConfig(learning_rate=0.5, decay=0.0, exploration=0.0, anywhere=0.0)
    after = advance(task, begin(task, s, config, q=q), config, 1)
    assert after.q[0, 1, 0, 0] == pytest.approx(0.4 + 0.5 * (0.0 + 0.9 * 0.8 - 0.4))
    assert (after.q != q).sum() == 1
    q[1, 1, 0] = [0.9, 0.8, 0, 0]  # and forward again, to the goal
    after = advance(task, begin(task, s, config, q=q), config, 2)
    assert after.q[1, 1, 0, 0] == pytest.approx(0.9 + 0.5 * (1.0 - 0.9))
    assert after.episodes == 1
    assert after.curve_motions.tolist() == [2]
    assert after.curve_rewards.tolist() == [1.0]


def test_the_rate_falls_with_the_updates():
    task, start = corridor(length=2)
    config = LearningConfig(learning_rate=0.5, decay=1.0, exploration=0.0, anywhere=0.0)
    s, q = task.state_of(start), np.zeros(task.q_shape)
    q[0, 1, 0, 0] = 0.1
    r = float(task.transitions[1][s, 0, 0])
    one = 0.1 + 0.5 * (r - 0.1)
    after = advance(task, begin(task, s, config, q=q), config, 2)
    assert after.q[0, 1, 0, 0] == pytest.approx(one + 0.25 * (r - one))
    assert after.visits[0, 1, 0, 0] == 2


def test_many_short_runs_learn_what_one_long_run_does():
    grid, start, goal = hall_map(0)
    task, config = RouteTask(grid, goal, motion=slipping()), LearningConfig()
    first = begin(task, task.state_of(start), config, seed=3)
    pieces = first
    for steps in (1, 10, 989, 4000):
        pieces = advance(task, copy.deepcopy(pieces), config, steps)
    assert same(pieces, advance(task, first, config, 5000))
    assert not same(pieces, advance(task, begin(task, first.start, config, seed=4), config, 5000))
    assert first.steps == 0


@pytest.mark.parametrize("seed", range(8))
def test_the_learnt_route_is_certified_within_five_percent(seed):
    grid, start, goal = hall_map(seed)
    task = RouteTask(grid, goal)
    s = task.state_of(start)
    learned = learn(task, begin(task, s, seed=seed))
    assert learned.status == "certified"
    route = roll_out(task, learned.learning.q, s)
    assert route.reached
    best = task.rewards.goal - solve(task).value.flat[s]
    assert (task.rewards.goal - route.rewards.sum()) / best <= 1.05 + 1e-9


@pytest.mark.parametrize("seed", range(2))
def test_it_learns_where_motions_may_fail(seed):
    grid, start, goal = water_map(seed, size=(24, 24))
    task = RouteTask(grid, goal, motion=slipping())
    learned = learn(task, begin(task, task.state_of(start), seed=seed), most_steps=30_000_000)
    assert learned.status == "certified"


def test_start_values_keep_the_optimum():
    grid, start, goal = water_map(2, size=(24, 24))
    task = RouteTask(grid, goal)
    s, best = task.state_of(start), solve(task).value
    for kind in ("straight", "distance"):
        config = LearningConfig(decay=0.0, start_values=kind, exploration=0.3, anywhere=0.9)
        after = advance(task, begin(task, s, config), config, 6_000_000)
        assert after.q.max(axis=3).flat[s] == pytest.approx(best.flat[s], abs=1e-6)


def test_the_papers_setting_learns_as_in_the_paper():
    grid, start, goal = water_map(5, size=(24, 24))
    task = RouteTask(grid, goal, paper_rewards())
    config = paper_learning()
    assert (config.learning_rate, config.exploration) == (0.5, 0.1)
    learned = learn(task, begin(task, task.state_of(start), config), config, gap=-1, most_episodes=130)
    after = learned.learning
    assert learned.status == "budget"
    assert after.episodes == 130
    # As in its Fig. 3-32: fewer motions, more reward, neither at its limit yet.
    assert np.median(after.curve_motions[-20:]) < 0.7 * np.median(after.curve_motions[:20])
    assert np.median(after.curve_rewards[-20:]) > 0.5 * np.median(after.curve_rewards[:20])
    late = learn(task, after, config, gap=-1, most_episodes=6000).learning
    assert np.median(late.curve_motions[-500:]) < 0.1 * np.median(after.curve_motions[-20:])
    assert np.median(late.curve_rewards[-500:]) == 1  # no bump, and nothing for a step


def test_an_unreachable_goal_is_said_at_once():
    grid, start, goal = water_map(1, "none")
    task = RouteTask(grid, goal)
    learned = learn(task, begin(task, task.state_of(start)))
    assert learned.status == "unreachable"
    assert learned.learning.steps == 0


def test_an_interrupt_keeps_what_was_learnt_and_learning_goes_on_from_there(monkeypatch):
    grid, start, goal = hall_map(1)
    task, config = RouteTask(grid, goal), LearningConfig()
    first = begin(task, task.state_of(start), config)
    calls = []

    def interrupted(*args, **kwargs):
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return advance(*args, **kwargs)

    monkeypatch.setattr(module, "advance", interrupted)
    stopped = learn(task, first, config, gap=-1, most_steps=200_000)
    assert stopped.status == "interrupted"
    assert stopped.learning.steps == 40_000
    monkeypatch.undo()
    resumed = learn(task, stopped.learning, config, gap=-1, most_steps=200_000)
    assert same(resumed.learning, learn(task, first, config, gap=-1, most_steps=200_000).learning)


def test_many_learners_are_the_same_as_one_after_the_other():
    grid, start, goal = water_map(0, size=(24, 24))
    task = RouteTask(grid, goal)
    s = task.state_of(start)
    many = learn_many(task, s, range(3), workers=2, gap=0.01)
    alone = [learn(task, begin(task, s, seed=seed), gap=0.01) for seed in range(3)]
    assert all(same(a.learning, b.learning) for a, b in zip(many, alone, strict=True))
    assert not same(many[0].learning, many[1].learning)


def test_bad_parameters_and_starts_are_refused():
    task, start = corridor()
    s = task.state_of(start)
    with pytest.raises(ConfigError, match=r"learning\.exploration"):
        begin(task, s, LearningConfig(exploration=1.5))
    with pytest.raises(ConfigError, match=r"rewards\.discount"):
        RouteTask(task.grid, task.goal, RewardConfig(discount=0.0))
    with pytest.raises(ConfigError, match="every motion must cost"):
        RewardConfig(per_metre=0.0)
    with pytest.raises(InputError, match="at the goal already"):
        begin(task, task.state_of(np.array([*task.goal, 0.0])))
    with pytest.raises(InputError, match="do not fit the grid"):
        begin(task, s, q=np.zeros((2, 2, 8, 4)))
    with pytest.raises(InputError, match="do not fit the grid"):
        begin(task, s, q=np.full(task.q_shape, np.nan))
    with pytest.raises(InputError, match="start: not a pose"):
        task.state_of(np.array([0.2, np.inf, 0.0]))
