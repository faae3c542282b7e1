"""`naraha extrinsics` as a user runs it, and what it refuses."""

import json

import pytest
from naraha.diagrams.extrinsics import X_HC as TRUE
from naraha.diagrams.extrinsics import ExtrinsicsScenario, extrinsics, make_extrinsics, wrong_guess
from naraha.diagrams.mission import Options
from naraha.diagrams.scenario import load_scenario
from naraha.systems.errors import ConfigError
from naraha.systems.slam.motion import distance_and_angle


def test_one_sweep_finds_the_camera_that_a_ruler_misplaced(tmp_path):
    scenario = load_scenario(ExtrinsicsScenario, "extrinsics", ["recording=null"], seed=0)
    assert extrinsics(scenario, Options(out=tmp_path)) == 0
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics["status"] == "done"
    assert metrics["guess_error_m"] == pytest.approx(0.03)
    assert metrics["guess_error_deg"] == pytest.approx(2.0)
    assert metrics["calibration_error_deg"] < 0.3
    assert metrics["calibration_error_m"] < 0.02
    assert metrics["views"] == 60


def test_the_guess_is_off_by_what_the_scenario_says_in_a_direction_of_the_seed():
    scenarios = [ExtrinsicsScenario(guess_error=0.05, guess_error_deg=3.0, seed=seed) for seed in (0, 0, 1)]
    first, again, other = (wrong_guess(scenario) for scenario in scenarios)
    distance, angle = distance_and_angle(TRUE.inverse() @ first)
    assert distance == pytest.approx(0.05)
    assert angle == pytest.approx(3.0 * 3.141592653589793 / 180)
    assert first.IsExactlyEqualTo(again)
    assert not first.IsNearlyEqualTo(other, 1e-3)


def test_a_robot_without_a_head_has_nothing_to_calibrate():
    with pytest.raises(ConfigError, match="head: no camera to calibrate"):
        make_extrinsics(ExtrinsicsScenario(head=None))


def test_too_few_views_fail_and_say_why_instead_of_giving_a_wrong_pose(tmp_path):
    settings = ["recording=null", "sweep.tilt_range_deg=[16, 19]"]
    scenario = load_scenario(ExtrinsicsScenario, "extrinsics", settings, seed=0)
    assert extrinsics(scenario, Options(out=tmp_path)) == 1
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics["status"] == "failed"
    assert metrics["reason"]
    assert metrics["calibration_error_m"] == pytest.approx(0.03)  # the guess stays
