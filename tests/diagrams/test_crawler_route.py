"""The crawler's motions in physics, as an environment and as a calibration."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from naraha.diagrams.calibrate import load_calibrate
from naraha.diagrams.calibrate_primitives import calibrate_primitives
from naraha.diagrams.crawler_route import NAME, CrawlerRouteConfig
from naraha.diagrams.grid_world import world_of
from naraha.diagrams.mission import Options
from naraha.diagrams.motions import make_motions
from naraha.diagrams.primitive_trials import PrimitiveTrials, sites, try_motion
from naraha.models.worlds import Solid
from naraha.systems.drive import PRIMITIVES, MotionPrimitivesConfig
from naraha.systems.errors import ConfigError, InputError
from naraha.systems.routes import (
    FREE,
    OCCUPIED,
    WATER,
    Ground,
    PolicyLookup,
    RouteGrid,
    RoutePolicy,
    RouteTask,
    read_primitives,
    solve,
)
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantValueSource

from tests.diagrams.test_missions import metrics_of, naraha

FORWARD, BACK, LEFT, RIGHT = range(4)


def lane():
    """A lane of 7 × 3 cells of 0.5 m with the goal at its end; water beside it."""
    kind = np.full((7, 3), OCCUPIED)
    kind[1:-1, 1], kind[3, 2] = FREE, WATER
    return RouteTask(RouteGrid.from_kind(kind, 0.5), (2.75, 0.75)), np.array([0.75, 0.75, 0.0])


def make(**more):
    task, start = lane()
    return gym.make(NAME, task=task, start=start, **more)


@pytest.fixture(scope="module")
def env():
    return make()


@pytest.mark.parametrize("observation", ["cell", "vector"])
def test_gymnasium_finds_nothing_wrong(observation):
    check_env(make(observation=observation).unwrapped)


def test_the_policy_of_the_grid_gets_its_value_in_physics(env):
    task, start = lane()
    solution = solve(task)
    observation, info = env.reset(seed=0)
    assert np.allclose(info["pose"], start, atol=0.15)
    total, ended = 0.0, False
    while not ended:
        observation, reward, ended, truncated, info = env.step(int(solution.q[tuple(observation)].argmax()))
        total += reward
        assert not truncated
        assert info["bumped"] == ""
    assert info["reached"]
    assert np.abs(info["pose"][:2] - task.goal).max() <= 0.25
    # The start is off by up to 0.1 m, and the last motion ends as soon as the goal's cell is reached.
    assert total == pytest.approx(solution.value.flat[task.state_of(start)], abs=0.4 * task.rewards.per_metre)


def test_a_policy_is_driven_as_a_table_by_odometry(station):
    task, start = lane()
    policy = RoutePolicy.of(task, solve(task).q)
    builder = DiagramBuilder()
    station.robot.start_xyz[:2] = start[:2].tolist()
    motions = make_motions(station, MotionPrimitivesConfig(), seed=0, world=world_of(task.grid))
    builder.AddSystem(motions)
    lookup = builder.AddSystem(PolicyLookup())
    table = builder.AddSystem(ConstantValueSource(AbstractValue.Make(policy)))
    builder.Connect(table.get_output_port(), lookup.GetInputPort("policy"))
    builder.Connect(motions.GetOutputPort("X_MB"), lookup.GetInputPort("X_MB"))
    builder.Connect(lookup.GetOutputPort("action"), motions.GetInputPort("action"))
    for name in ("cheat.X_WB", "status"):
        builder.ExportOutput(motions.GetOutputPort(name), name)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.1)
    assert diagram.GetOutputPort("status").Eval(simulator.get_context()) == "running"
    simulator.AdvanceTo(14.0)
    assert diagram.GetOutputPort("status").Eval(simulator.get_context()) == "idle"
    x, y, _ = diagram.GetOutputPort("cheat.X_WB").Eval(simulator.get_context()).translation()
    assert [x, y] == pytest.approx(task.goal, abs=0.05)


def test_motions_lead_one_cell_or_one_heading_on(env):
    _, info = env.reset(seed=1)
    before = info["pose"]
    for action, expected in ((FORWARD, (0.5, 0)), (LEFT, (0, np.pi / 4)), (RIGHT, (0, -np.pi / 4)), (BACK, (-0.5, 0))):
        _, _, _, _, info = env.step(action)
        moved = info["pose"] - before
        assert moved[0] == pytest.approx(expected[0], abs=0.02)
        if action != FORWARD:  # the first one also turns to the heading of the grid
            assert moved[2] == pytest.approx(expected[1], abs=0.03)
        before = info["pose"]


def test_what_is_run_into_costs_and_the_robot_is_put_back(env):
    task, _ = lane()
    rewards = task.rewards
    for start, kind, cost in (
        ([0.75, 0.75, 0.0], "occupied", rewards.obstacle),
        ([1.75, 0.75, -np.pi / 2], "water", rewards.water),
    ):
        _, info = env.reset(seed=2, options={"start": np.array(start)})
        before = info["pose"]
        _, reward, terminated, truncated, info = env.step(BACK)
        assert info["bumped"] == kind
        assert reward == pytest.approx(cost - rewards.per_turn)
        assert not terminated
        assert not truncated
        assert info["pose"] == pytest.approx(before)
        # It goes on from there as if nothing had been.
        _, _, _, _, info = env.step(LEFT)
        assert info["bumped"] == ""


def test_by_odometry_too_the_robot_knows_where_it_is_after_it_was_put_back():
    env = make(config=CrawlerRouteConfig(localisation="odometry", start_offset=0, start_heading_deg=0))
    _, info = env.reset(seed=0)
    for _ in range(3):
        assert env.step(BACK)[4]["bumped"] == "occupied"
    _, _, _, _, info = env.step(FORWARD)
    assert info["pose"] == pytest.approx([1.25, 0.75, 0.0], abs=0.03)


def test_what_holds_the_robot_up_is_run_into():
    task, start = lane()
    world = world_of(task.grid)
    world.solids.append(Solid(name="post", box=[0.1, 0.3, 0.6], xyz=[1.4, 0.75, 0.3], surface="wall"))
    env = gym.make(NAME, task=task, start=start, world=world)
    env.reset(seed=0)
    _, reward, _, _, info = env.step(FORWARD)
    assert info["bumped"] == "occupied"
    assert reward < -4


def test_the_same_seed_gives_the_same_run_and_another_does_not(env):
    def run(seed):
        env.reset(seed=seed)
        return np.array([env.step(a)[4]["pose"] for a in (FORWARD, LEFT)])

    first = run(3)
    assert np.array_equal(first, run(3))
    assert not np.allclose(first, run(4))


def test_the_vector_says_the_same_as_the_cell():
    env = make(observation="vector")
    observation, info = env.reset(seed=0)
    x, y, heading = info["pose"]
    assert observation == pytest.approx([x / 3.5, y / 1.5, np.cos(heading), np.sin(heading)], abs=1e-6)


def test_episodes_are_truncated_by_the_time_limit():
    env = make(max_episode_steps=2)
    env.reset(seed=0)
    assert [env.step(LEFT)[2:4] for _ in range(2)] == [(False, False), (False, True)]


def test_bad_input_is_refused():
    task, _ = lane()
    with pytest.raises(InputError, match="needs a start"):
        gym.make(NAME, task=task)
    with pytest.raises(InputError, match="at the goal already"):
        gym.make(NAME, task=task, start=np.array([2.75, 0.75, 0]))
    with pytest.raises(InputError, match="unknown observation"):
        make(observation="image")
    with pytest.raises(ConfigError, match="time_step"):
        make(config=CrawlerRouteConfig(time_step=0.0))
    env = make()
    env.reset(seed=0)
    with pytest.raises(InputError, match="not an action"):
        env.unwrapped.step(4)


def test_a_world_of_a_grid_is_smaller_by_the_growth():
    kind = np.zeros((9, 9))
    kind[2:6, 3:7], kind[8, 8], kind[2:5, 8] = OCCUPIED, OCCUPIED, WATER
    world = world_of(RouteGrid.from_kind(kind, 0.5, (-1, -2)), growth=0.3)
    blocks = {solid.name: solid for solid in world.solids if not solid.name.startswith(("floor", "wall"))}
    assert list(blocks) == ["occupied_0"]  # nothing is left of single cells
    assert blocks["occupied_0"].box == pytest.approx([1.4, 1.4, 0.5])
    assert blocks["occupied_0"].xyz == pytest.approx([1.0, 0.5, 0.25])


@pytest.fixture
def station():
    scenario = load_calibrate("crawler", ("plant.time_step=0.01",))
    scenario.imu.period = 0.02
    return scenario


class TestPrimitives:
    @pytest.mark.parametrize(
        ("ground", "action", "expected"),
        [
            ("flat", FORWARD, (0.5, 0, 0)),
            ("slope_up", BACK, (-0.5, 0, 0)),
            ("side_slope", FORWARD, (0.5, 0, 0)),
            ("rough", RIGHT, (0, 0, -np.pi / 4)),
            ("stair_up", FORWARD, (0.47, 0, 0)),
            ("stair_down", BACK, (-0.47, 0, 0)),
        ],
    )
    def test_a_motion_does_about_what_it_says(self, station, ground, action, expected):
        config = PrimitiveTrials()
        site = sites(config)[ground]
        trial = try_motion(station, site, action, np.random.default_rng(0), config)
        assert trial.ended
        assert trial.moved == pytest.approx(expected, abs=0.06 if ground != "rough" else 0.3)
        # On a crest tracks turn more easily than on a floor, on which they have their gauge.
        assert (-0.6 if ground == "rough" else -0.05) < trial.slip < 0.7
        assert trial.tilt == pytest.approx(site.slope, abs=0.25)

    @pytest.mark.parametrize("ground", ["slope_up", "stair_up"])
    def test_turning_on_a_slope_slides_down(self, station, ground):
        config = PrimitiveTrials()
        trial = try_motion(station, sites(config)[ground], LEFT, np.random.default_rng(0), config)
        assert trial.moved[0] < -0.05
        assert trial.slip > 0.1

    def test_the_command_writes_what_the_motions_come_to(self, station, tmp_path, monkeypatch):
        station.primitives.trials = 2
        flat = {"flat": sites(station.primitives)["flat"]}
        for module in ("primitive_trials", "calibrate_primitives"):
            monkeypatch.setattr(f"naraha.diagrams.{module}.sites", lambda config: flat)
        assert calibrate_primitives(station, Options(out=tmp_path)) == 0
        primitives = read_primitives(tmp_path / "primitives.yaml")
        assert (primitives.robot, primitives.step) == ("crawler", 0.5)
        assert list(primitives.grounds["flat"].motions) == list(PRIMITIVES)
        outcome = primitives.grounds["flat"].motions["forward"]
        assert (outcome.trials, outcome.failed) == (2, 0)
        assert outcome.mean[0] == pytest.approx(0.5, abs=0.01)
        rows = (tmp_path / "trials.csv").read_text().splitlines()
        assert len(rows) == 1 + 2 * 4
        assert metrics_of(tmp_path)["drives"] == 8

    def test_ctrl_c_keeps_what_was_driven_and_writes_no_half_a_file(self, station, tmp_path, monkeypatch):
        def broken_off(*arguments):
            yield {"flat": Ground()}, [["flat", "forward", 0, 0.5, 0.0, 0.0, True, 2.0, 0.0, 0.0]]
            raise KeyboardInterrupt

        monkeypatch.setattr("naraha.diagrams.calibrate_primitives.measure", broken_off)
        assert calibrate_primitives(station, Options(out=tmp_path)) != 0
        assert metrics_of(tmp_path)["status"] == "interrupted"
        assert (tmp_path / "trials.csv").read_text().count("flat") == 1
        assert not (tmp_path / "primitives.yaml").exists()

    def test_another_kind_of_calibration_is_refused(self, tmp_path):
        result = naraha("calibrate", "--kind", "colour", "--out", tmp_path)
        assert result.returncode == 2
        assert "--kind: unknown calibration, got 'colour' (valid: ability, primitives)" in result.stderr
