"""The mission in which the snake frees itself."""

import csv
import json
from dataclasses import replace

import matplotlib.image
import numpy as np
import pytest
from naraha.diagrams.mission import Options
from naraha.diagrams.recover import RecoverScenario, RecoverScript, ask, choose_best, make_recover, recover
from naraha.diagrams.recover_script import STEP, label_of
from naraha.diagrams.scenario import dump_scenario, load_scenario
from naraha.diagrams.snake_belief import believe
from naraha.diagrams.snake_rehearsal import advance_of_copy, plan
from naraha.models.worlds.stuck import KINDS
from naraha.systems.errors import ConfigError
from naraha.systems.snake.actuator_faults import ActuatorFaultsConfig, Fault
from naraha.systems.snake.recovery_planner import RankedProposal, Rehearsal, cheap_moves
from naraha.systems.snake.snake_pilot import Move
from rich.console import Console

from tests.snake.stuck_snake import driven, settled


def quick(**changes):
    return replace(RecoverScenario(recording=None, rehearse=False), **changes)


def play(scenario, choose=choose_best):
    case, run = make_recover(scenario)
    lines = []
    script = RecoverScript(scenario, case, run, choose, lines.append)
    for _ in script.steps():
        run.advance(STEP)
        script.watch()
    return script, lines


@pytest.mark.parametrize("kind", KINDS)
def test_every_class_is_noticed_and_the_snake_drives_on(kind):
    script, _ = play(quick(stuck=kind, seed=1))
    metrics = script.metrics
    assert script.ending.status == "done"
    assert metrics.freed
    assert abs(metrics.stuck_advance_m) < 0.01
    assert metrics.detected_class == metrics.true_class == kind
    assert abs(metrics.detected_unit - metrics.true_unit) <= 1
    assert metrics.advance_after_m >= 0.5
    assert metrics.min_limit_margin_rad > 0
    assert metrics.max_tilt_rad < np.deg2rad(20)
    if metrics.move.startswith("recover"):
        assert metrics.head_motion_m < 0.02
        assert metrics.control_point_error_m < 0.005
        assert metrics.control_point_error_max_m < 0.005
        assert metrics.target_distance_end_m < metrics.target_distance_start_m


def test_a_snake_that_is_not_stuck_is_left_alone():
    script, _ = play(quick(stuck=1, really=False))
    assert script.ending.reason == "it is not stuck"
    assert script.metrics.attempts == 0
    assert script.metrics.stuck_advance_m > 0.2


def test_nothing_is_tried_when_nobody_chooses():
    script, _ = play(quick(stuck=1), choose=lambda ranked: -1)
    assert script.ending.status == "failed"
    assert "nothing was tried" in script.ending.reason


def test_after_an_attempt_that_fails_the_next_is_tried():
    cheap_first = lambda ranked: next((i for i, item in enumerate(ranked) if item.proposal.name == "relax"), 0)  # noqa: E731
    script, lines = play(quick(stuck=1, seed=1, drive_time=6.5), choose=cheap_first)
    assert script.metrics.freed
    assert script.metrics.attempts == 2
    assert any("relax" in line for line in lines)


def test_a_dead_actuator_in_the_segment_is_noticed_and_nothing_breaks():
    script, lines = play(quick(stuck=1, seed=0, attempts=1, actuators=dead("p5", "dead")))
    assert script.ending.status in ("done", "failed")
    assert any("recovery" in line for line in lines)
    assert np.isfinite(script.metrics.head_motion_m)


def test_without_the_angle_of_a_joint_nothing_is_planned():
    script, _ = play(quick(stuck=1, seed=0, actuators=dead("y4", "lost_link")))
    assert script.ending.status == "failed"
    assert script.metrics.attempts == 0


def dead(joint, kind):
    return ActuatorFaultsConfig(faults=[Fault(joint=joint, kind=kind, time=1.0)])


@pytest.mark.parametrize("kind", KINDS)
def test_the_copy_in_the_believed_world_is_as_stuck_as_the_robot(kind):
    scenario = quick()
    _, run = settled(kind, 2)
    driven(run, 2.5)
    diagnosis = run.read("detector.diagnosis")
    run.give(Move())
    run.advance(0.3)
    belief = believe(
        diagnosis,
        joint_angles=run.read("station.joint_angles"),
        joint_command=run.read("pilot.joint_command"),
        rpy=run.read("station.rpy"),
        ranges=run.read("station.ranges"),
        snake=scenario.snake,
    )
    belief.world.check("belief")
    assert abs(advance_of_copy(scenario, belief)) < 0.02
    names = [solid.name for solid in belief.world.solids]
    assert names[0] == "floor"
    assert len(names) > 1


def test_the_rehearsal_tells_what_frees_from_what_does_not():
    scenario = quick()
    _, run = settled(1, 3)
    driven(run, 2.5)
    diagnosis, items = run.read("detector.diagnosis"), run.read("planner.proposals").items
    run.give(Move())
    run.advance(0.3)
    belief = believe(
        diagnosis,
        joint_angles=run.read("station.joint_angles"),
        joint_command=run.read("pilot.joint_command"),
        rpy=run.read("station.rpy"),
        ranges=run.read("station.ranges"),
        snake=scenario.snake,
    )
    wanted = (next(i for i in items if i.name == "relax"), next(i for i in items if i.name == "recover"))
    rehearsed = plan(scenario, belief, wanted)
    assert rehearsed.faithful
    assert [item.proposal.name for item in rehearsed.ranked] == ["recover", "relax"]
    assert rehearsed.ranked[1].objection


def test_an_operator_is_asked_by_number(monkeypatch, capsys):
    scenario = quick()
    proposals = cheap_moves(scenario.planner)
    result = Rehearsal(0.5, 0.0, 0.08, 0.4, 0.0, 3.0)
    ranked = tuple(RankedProposal(p, result, 0.5) for p in proposals)
    answers = iter(["7", "x", "2"])
    monkeypatch.setattr("builtins.input", lambda prompt: next(answers))
    assert ask(ranked) == 1
    assert label_of(proposals[1]) in capsys.readouterr().out
    monkeypatch.setattr("builtins.input", lambda prompt: "")
    assert ask(ranked) == -1


def test_the_mission_leaves_its_products(tmp_path):
    scenario = load_scenario(RecoverScenario, "stuck", ["stuck=4", "rehearse=false", "drive_time=7.0"], seed=0)
    out = tmp_path / "out"
    assert recover(scenario, Options(out=out, console=Console(stderr=True, quiet=True))) == 0
    products = {"metrics.json", "scenario.yaml", "recording.html", "recovery.csv", "recovery.png"}
    assert {p.name for p in out.iterdir()} == products
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["status"] == "done"
    assert metrics["freed"] is True
    assert all(not isinstance(value, (dict, list)) for value in metrics.values())
    with (out / "recovery.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) > 50
    errors = np.array([[float(row[f"error_{axis}_m"]) for axis in "xyz"] for row in rows])
    # At the start the body, which lay on a stone, takes up the load that the joints bear from then on.
    assert np.linalg.norm(errors, axis=1).max() < 0.02
    assert np.linalg.norm(errors, axis=1)[-1] < 0.001
    # w_e is drawn from w_ref and the error; d of the middle comes near its target.
    for axis in ("x_m", "y_m", "z_m"):
        gap = [float(row[f"control_{axis}"]) - float(row[f"reference_{axis}"]) for row in rows]
        np.testing.assert_allclose(gap, [float(row[f"error_{axis}"]) for row in rows], atol=2e-6)
    assert min(float(row["target_distance_m"]) for row in rows) < 0.5 * metrics["target_distance_start_m"]
    assert max(float(row["head_motion_m"]) for row in rows) == pytest.approx(metrics["head_motion_m"], rel=1e-3)
    assert matplotlib.image.imread(out / "recovery.png").std() > 0.05
    again = load_scenario(RecoverScenario, str(out / "scenario.yaml"))
    assert dump_scenario(again) == dump_scenario(scenario)


def test_bad_values_are_refused_before_anything_runs():
    with pytest.raises(ConfigError, match=r"stuck.*valid: >= 1 and <= 5"):
        load_scenario(RecoverScenario, "stuck", ["stuck=6"])
    with pytest.raises(ConfigError, match="all sensors"):
        make_recover(quick(pads=None))
