from pathlib import Path

import numpy as np
import pytest
from naraha.diagrams.learn import learn_routes, load_learn
from naraha.diagrams.mission import Options
from naraha.diagrams.robot_files import robot_primitives
from naraha.systems.errors import ConfigError, ScenarioError
from naraha.systems.routes import (
    ACTIONS,
    Ground,
    Outcome,
    Primitives,
    motion_model,
    outcome_of,
    read_policy,
    read_primitives,
    write_primitives,
)
from naraha.systems.sensing import write_cloud

from tests.diagrams.test_missions import metrics_of

from .route_examples import floor_with_pool
from .test_motion_model import mean_motion


def measured(**more):
    """Motions that all fall a little short, and lead off by as much as `covariance` says."""
    means = {
        "forward": [0.48, 0.01, 0.02],
        "back": [-0.48, 0, 0],
        "left": [0, 0, 0.75],
        "right": [0.02, 0, -0.75],
    }
    motions = {name: Outcome(trials=20, mean=mean, **more) for name, mean in means.items()}
    return Primitives(robot="crawler", step=0.5, grounds={"flat": Ground(motions=motions)})


def test_statistics_of_drives_are_those_of_the_ones_that_ended():
    rng = np.random.default_rng(0)
    spread = np.array([[4e-4, 1e-4, 0], [1e-4, 9e-4, 0], [0, 0, 1e-4]])
    samples = rng.multivariate_normal([0.5, 0.0, 0.1], spread, 5000)
    ended = np.arange(5000) % 10 > 0
    samples[~ended] = 7.0
    outcome = outcome_of(samples, ended, np.where(ended, 2.0, 99.0), np.where(ended, 0.1, 99.0))
    assert outcome.failed == pytest.approx(0.1)
    assert outcome.mean == pytest.approx([0.5, 0.0, 0.1], abs=0.002)
    assert np.array(outcome.covariance) == pytest.approx(spread, abs=5e-5)
    assert (outcome.time, outcome.slip) == (2.0, 0.1)


def test_the_spread_on_the_grid_has_the_mean_that_was_measured():
    primitives = measured(covariance=np.diag([0.02, 0.01, 0.05]).tolist())
    model = motion_model(primitives, 0.5, least=0.0)
    for action in ACTIONS:
        mean = np.array(primitives.grounds["flat"].motions[action].mean) / [0.5, 0.5, np.pi / 4]
        assert mean_motion(model, "flat", action)[[0, 2]] == pytest.approx(mean[[0, 2]], abs=0.01)
        assert len(model.outcomes("flat", action)) > 3


def test_motions_without_spread_are_nearly_certain():
    model = motion_model(measured(), 0.5)
    assert model.outcomes("flat", "left")[0] == pytest.approx((0.75 / (np.pi / 4), 0, 0, 1), abs=1e-6)


def test_what_failed_stays_where_it_was():
    primitives = measured(failed=0.25)
    stayed = {outcome[1:]: outcome[0] for outcome in motion_model(primitives, 0.5).outcomes("flat", "left")}[0, 0, 0]
    whole = 0.75 / (np.pi / 4)
    assert stayed == pytest.approx(0.25 + 0.75 * (1 - whole), abs=1e-3)


def test_grounds_of_one_kind_count_equally_and_others_are_flat():
    primitives = measured()
    up, down = (Ground(terrain="slope", motions={"left": Outcome(mean=[x, 0, np.pi / 4])}) for x in (-0.5, 0.0))
    primitives.grounds |= {"up": up, "down": down}
    model = motion_model(primitives, 0.5)
    assert np.array(model.outcomes("slope", "left")) == pytest.approx(np.array([(0.5, 1, 4, 1), (0.5, 0, 0, 1)]))
    assert model.outcomes("steps", "left") == model.outcomes("flat", "left")


def test_a_smaller_cell_has_the_same_share_of_error_in_steps_but_not_in_turns():
    primitives = measured()
    primitives.grounds["flat"].motions["left"] = Outcome(mean=[-0.1, 0, np.pi / 4])
    small, large = (np.array(motion_model(primitives, cell).outcomes("flat", "forward")) for cell in (0.1, 0.5))
    assert small == pytest.approx(large)
    for cell, slid in ((0.1, 1.0), (0.5, 0.2)):
        assert mean_motion(motion_model(primitives, cell), "flat", "left")[0] == pytest.approx(-slid)


def test_what_is_written_is_read_back(tmp_path):
    primitives = measured(covariance=(np.eye(3) * 1e-4).tolist(), slip=-0.2)
    write_primitives(tmp_path / "primitives.yaml", primitives)
    assert read_primitives(tmp_path / "primitives.yaml") == primitives


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("step: 0.5", "step: -1"), "step: out of range"),
        (("  flat:", "  flat:\n    colour: red"), "not measured motions"),
        (("terrain: flat", "terrain: lava"), "grounds.flat.terrain: unknown value"),
        (("      forward:", "      jump:"), "unknown motion"),
        (("[0.48, 0.01, 0.02]", "[0.48, 0.01]"), "mean"),
        (("- [0.0, 0.0, 0.0]", "- [0.0, 1.0, 0.0]"), "not a covariance"),
    ],
)
def test_a_damaged_file_is_refused_by_its_place(tmp_path, change, words):
    path = Path(tmp_path / "primitives.yaml")
    write_primitives(path, measured())
    text = path.read_text()
    assert change[0] in text
    path.write_text(text.replace(*change, 1))
    with pytest.raises(ConfigError, match=words) as caught:
        read_primitives(path)
    assert "primitives.yaml" in str(caught.value)


def test_no_file_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="No such file"):
        read_primitives(tmp_path / "nothing.yaml")


def test_the_crawler_s_motions_are_there_for_every_kind_that_was_driven():
    primitives = robot_primitives("crawler")
    assert primitives.robot == "crawler"
    assert {ground.terrain for ground in primitives.grounds.values()} == {"flat", "slope", "steps", "rough"}
    for ground in primitives.grounds.values():
        assert list(ground.motions) == list(ACTIONS)
        assert all(outcome.failed == 0 for outcome in ground.motions.values())
    model = motion_model(primitives, 0.5)
    assert model.outcomes("flat", "forward")[0][0] > 0.98
    # Tracks that turn on a slope slide down it, more so on a stair.
    slope, stair = (sum(p for p, cells, _, _ in model.outcomes(t, "left") if cells) for t in ("slope", "steps"))
    assert stair > slope > 0.1
    with pytest.raises(ScenarioError, match=r"no motions were measured.*crawler"):
        robot_primitives("pioneer")


def test_routes_are_learnt_with_the_spread_that_was_measured(tmp_path):
    write_cloud(tmp_path / "map.ply", floor_with_pool())
    values = []
    for motions in ("exact", "measured"):
        scenario = load_learn("learn", [-2.5, 0, 0], [2.5, 0], [f"motions={motions}"])
        assert learn_routes(tmp_path / "map.ply", scenario, Options(out=tmp_path / motions)) == 0
        assert metrics_of(tmp_path / motions)["optimality_gap"] <= 0.05
        policy = read_policy(tmp_path / motions / "policy_0.csv")
        values.append(policy.q[policy.free].max(axis=-1).mean())
    # Where motions may lead astray, ways are worth less.
    assert values[1] < values[0]
