import numpy as np
import pytest
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.routes import (
    LearningConfig,
    RouteGrid,
    RouteLearner,
    RouteLearnerConfig,
    RouteTask,
    begin,
    learn,
    optimality_gap,
    roll_out,
    solve,
)
from naraha.systems.routes import route_learner as module
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator

from .maps import hall_map, water_map


class World:
    """A learner on its own with fixed inputs that can be changed."""

    def __init__(self, grid, start, goal, **config):
        self.system = RouteLearner(RouteLearnerConfig(**config))
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        self.give(grid=grid, start=start, goal=goal)

    def give(self, *, grid=None, start=None, goal=None):
        if grid is not None:
            self.system.GetInputPort("route_grid").FixValue(self.context, AbstractValue.Make(grid))
        for name, value in (("start", start), ("goal", goal)):
            if value is not None:
                self.system.GetInputPort(name).FixValue(self.context, np.array(value, float))

    def run(self, duration):
        self.simulator.AdvanceTo(self.context.get_time() + duration)
        return self.progress, self.policy

    @property
    def progress(self):
        return self.system.GetOutputPort("learning").Eval(self.context)

    @property
    def policy(self):
        return self.system.GetOutputPort("policy").Eval(self.context)


def test_it_learns_a_certified_route_while_time_goes_on_and_then_rests():
    grid, start, goal = hall_map(0)
    world = World(grid, start, goal, steps_per_update=500)
    assert world.progress.status == "waiting"
    early, _ = world.run(0.05)
    assert early.status == "learning"
    assert early.steps == 500
    late, policy = world.run(20.0)
    assert late.certified
    assert late.gap <= 0.05
    assert len(late.curve_motions) == late.episodes > 0
    task = RouteTask(grid, goal)
    assert policy.fits(grid)
    assert roll_out(task, policy.q, task.state_of(start)).reached
    assert optimality_gap(task, policy.q, task.state_of(start), solve(task)) == late.gap
    assert world.run(1.0)[0].steps == late.steps


def test_the_same_seed_learns_the_same_and_another_does_not():
    grid, start, goal = hall_map(1)

    def learnt(seed):
        return World(grid, start, goal, steps_per_update=3000, seed=seed, gap=0.0).run(0.35)[1].q

    assert np.array_equal(learnt(1), learnt(1))
    assert not np.array_equal(learnt(1), learnt(2))


def test_a_new_map_begins_anew_from_what_was_learnt():
    grid, start, goal = hall_map(2)
    world = World(grid, start, goal)
    assert world.run(5.0)[0].certified
    kind = grid.kind.copy()
    kind[-8:-6, 2] = 1
    wider = RouteGrid.from_kind(np.pad(kind, 2, constant_values=6), grid.cell, grid.origin - 2 * grid.cell)
    world.give(grid=wider)
    progress, policy = world.run(0.1)
    assert policy.fits(wider)
    assert progress.steps <= 200_000
    again, _ = world.run(3.0)
    fresh, _ = World(wider, start, goal).run(3.0)
    assert again.certified
    assert fresh.certified
    assert again.steps <= fresh.steps


def test_a_new_goal_is_learnt_and_an_old_one_recalled_without_learning():
    grid, start, goal = water_map(0)
    world = World(grid, start, goal)
    assert world.run(3.0)[0].certified
    world.give(goal=grid.centre_of(grid.nearest_free(np.array(goal) - [1.0, 0.0])))
    assert world.run(3.0)[0].certified
    world.give(goal=goal)
    progress, policy = world.run(0.05)
    assert progress.certified
    assert policy.goal == goal
    assert progress.steps == 0


def test_a_robot_under_way_keeps_its_policy_and_arrives():
    grid, start, goal = water_map(1)
    world = World(grid, start, goal)
    assert world.run(3.0)[0].certified
    task = RouteTask(grid, goal)
    poses = roll_out(task, world.policy.q, task.state_of(start)).poses
    world.give(start=poses[len(poses) // 2])
    progress, policy = world.run(0.1)
    assert progress.certified
    assert policy.fits(grid)
    world.give(start=poses[-1])
    assert world.run(0.1)[0].status == "arrived"
    world.give(start=poses[0])
    assert world.run(0.1)[0].certified


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"goal": (99.0, 0.0)}, "goal: outside the grid"),
        ({"goal": (np.nan, 0.0)}, "goal: outside the grid"),
        ({"start": (np.nan, 0.0, 0.0)}, "start: not a pose"),
        ({"start": (-0.9, -1.9, 0.0)}, "start: in a cell that is fence"),
    ],
)
def test_it_waits_with_a_reason_and_goes_on_when_that_is_gone(change, words):
    grid, start, goal = water_map(2)
    world = World(grid, start, goal)
    world.give(**change)
    progress, policy = world.run(0.3)
    assert progress.status == "waiting"
    assert words in progress.reason
    assert policy.action_of(start) is None
    world.give(start=start, goal=goal)
    assert world.run(3.0)[0].certified


def test_it_waits_where_no_way_leads_and_solves_the_map_only_once(monkeypatch):
    grid, start, goal = water_map(1, "none")
    calls = []
    monkeypatch.setattr(module, "solve", lambda task: calls.append(1) or solve(task))
    progress, _ = World(grid, start, goal).run(1.0)
    assert (progress.status, len(calls)) == ("waiting", 0)
    assert "no way leads" in progress.reason
    open_grid, start, goal = water_map(1, "both")
    calls.clear()
    World(open_grid, start, goal, steps_per_update=1000).run(1.0)
    assert len(calls) == 1


def test_the_budget_ends_it_without_a_certificate():
    grid, start, goal = hall_map(0)
    config = LearningConfig(start_values="zero")
    progress, _ = World(grid, start, goal, steps_per_update=1000, most_steps=3500, learning=config).run(2.0)
    assert (progress.status, progress.steps) == ("budget", 3500)


def test_it_learns_what_the_function_learns():
    grid, start, goal = hall_map(3)
    task = RouteTask(grid, goal)
    progress, policy = World(grid, start, goal, seed=7, steps_per_update=3000, gap=0.0).run(0.35)
    assert progress.steps > 3000
    function = learn(task, begin(task, task.state_of(start), seed=7), gap=-1, most_steps=progress.steps)
    assert np.array_equal(policy.q, function.learning.q)


def test_wrong_values_are_refused():
    with pytest.raises(ConfigError, match=r"route_learner\.learning\.exploration"):
        RouteLearner(RouteLearnerConfig(learning=LearningConfig(exploration=2.0)))
    grid, start, goal = water_map(0)
    world = World(grid, start, goal)
    world.system.GetInputPort("route_grid").FixValue(world.context, AbstractValue.Make({}))
    with pytest.raises(PortError, match=r"RouteLearner\.route_grid: wrong type"):
        world.run(0.2)
