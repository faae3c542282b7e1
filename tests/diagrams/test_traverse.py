"""Drives to a goal and calibrations, by the command as a user gives it and in parts."""

import csv

import numpy as np
import pytest
from naraha.diagrams.ability_trials import HUNG, PASSED, SLIPPED, Interval, TrialConfig, drive, find_interval
from naraha.diagrams.calibrate import ability_from, load_calibrate, measured_roughness, turn_slide
from naraha.diagrams.obstacle_distance import ObstacleDistance
from naraha.diagrams.robot_files import has_primitives, robot_ability
from naraha.diagrams.traverse import load_traverse, make_traverse
from naraha.models.worlds import load_world
from naraha.systems.errors import InputError
from naraha.systems.routes import Ground, Outcome, Primitives
from naraha.systems.traversability import Mamdani, TerrainConfig, read_ability
from pydrake.math import RigidTransform

from tests.diagrams.test_missions import metrics_of, naraha

ROBOTS = ("pioneer", "amphibious", "crawler")


def test_the_weak_robot_drives_around_the_ramps(tmp_path):
    result = naraha("traverse", "--robot", "pioneer", "--world", "e2827", "--out", tmp_path, "--set", "recording=null")
    assert result.returncode == 0, result.stderr
    metrics = metrics_of(tmp_path)
    assert metrics["status"] == "done"
    assert metrics["reached"]
    assert not metrics["over_ramps"]
    assert metrics["collisions"] == 0
    assert metrics["max_tilt_rad"] < 0.02
    assert metrics["min_clearance_m"] > 0.05
    with (tmp_path / "drive.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert rows[-1]["status"] == "arrived"
    assert max(float(row["true_y_m"]) for row in rows) > 3.0
    assert (tmp_path / "histograms.csv").read_text().count("\n") > 100


def test_a_strong_robot_drives_over_them(tmp_path):
    settings = ["recording=null", "duration=60"]
    result = naraha(
        "traverse", "--robot", "amphibious", "--out", tmp_path, *(w for s in settings for w in ("--set", s))
    )
    assert result.returncode == 0, result.stderr
    metrics = metrics_of(tmp_path)
    assert metrics["reached"]
    assert metrics["over_ramps"]
    assert metrics["collisions"] == 0


def test_a_goal_behind_walls_ends_with_no_way(tmp_path):
    settings = ["recording=null", "goal=[9.0, 0.0]", "duration=100"]
    result = naraha("traverse", "--robot", "pioneer", "--out", tmp_path, *(w for s in settings for w in ("--set", s)))
    assert result.returncode == 1
    metrics = metrics_of(tmp_path)
    assert metrics["final_status"] == "no way"
    assert not metrics["reached"]
    assert metrics["collisions"] == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--robot", "tank"], "--robot: unknown robot, got 'tank'"),
        (["--world", "nowhere"], "no such scenario"),
        (["--set", "ability=mine"], "ability: no such ability of 'pioneer'"),
        (["--set", "goal=[1, 2, 3]"], "goal: wrong length"),
        (["--set", "terrain.width=0"], "terrain.width: out of range"),
        (["--set", "goal=[.nan, 0]"], "goal: out of range"),
    ],
)
def test_bad_input_is_one_line(tmp_path, arguments, words):
    result = naraha("traverse", *arguments, "--out", tmp_path)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert words in result.stderr


@pytest.mark.parametrize("robot", ROBOTS)
def test_every_robot_gets_a_station_with_its_own_sensors(robot):
    diagram = make_traverse(load_traverse("e2827", robot, ["recording=null"]))
    assert diagram.HasOutputPort("terrain.features")
    station = diagram.GetSubsystemByName("station")
    assert station.HasOutputPort("tilt_angle") == (robot != "crawler")


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_local_cloud_is_kept_on_the_pose_that_steers(robot):
    diagram = make_traverse(load_traverse("e2827", robot, ["recording=null"]))
    sources = {}
    for (system, port), (source, output) in diagram.connection_map().items():
        key = system.get_name(), system.get_input_port(port).get_name()
        sources[key] = source.get_name(), source.get_output_port(output).get_name()
    assert sources["local_cloud", "X_OB"] == sources["controller", "X_MB"] == sources["memory", "X_MB"]
    assert sources["controller", "X_MB"] == (("slam", "X_MB") if robot == "crawler" else ("odometry", "X_OB"))


def test_distance_is_to_what_is_tall_and_not_to_ramps():
    scenario = load_traverse("e2827", "pioneer", ["recording=null"])
    diagram = make_traverse(scenario)
    context = diagram.CreateDefaultContext()
    distance = ObstacleDistance(diagram, load_world("e2827", 0), [0.4, 0.4])
    # The western wall is at x = -4.8, its face that far from the front of a robot that stands before it.
    assert distance.nearest(context, RigidTransform([-4.0, -0.4, 0.1])) == pytest.approx(0.6, abs=0.02)
    assert distance.nearest(context, RigidTransform([0.0, 0.0, 0.3])) > 1.5
    assert distance.nearest(context, RigidTransform([-4.7, -0.4, 0.1])) <= 0


def test_the_search_ends_between_what_passes_and_what_does_not():
    def passes(level, seed):
        return PASSED if level < 0.3 - 0.01 * seed else SLIPPED

    found = find_interval(passes, 1.0, TrialConfig(drives=3, precision=0.01, halvings=12))
    # The third drive is the first to fail.
    assert found.passes < 0.28 <= found.fails
    assert found.fails - found.passes <= 0.01 * found.fails
    assert found.reason == SLIPPED
    everything = find_interval(lambda level, seed: PASSED, 1.0, TrialConfig(drives=2))
    assert (everything.passes, everything.fails, everything.drives) == (1.0, np.inf, 2)
    nothing = find_interval(lambda level, seed: HUNG, 1.0, TrialConfig())
    assert nothing.passes == 0.0


@pytest.mark.parametrize(
    ("robot", "kind", "level", "expected"),
    [
        ("pioneer", "pitch_slope", 0.15, True),
        ("pioneer", "pitch_slope", 0.35, False),
        ("pioneer", "step", 0.06, False),
        ("amphibious", "pitch_slope", 0.45, True),
        ("amphibious", "roll_slope", 0.9, False),
        ("crawler", "step", 0.1, True),
    ],
)
def test_drives_pass_what_a_robot_can_and_fail_at_what_it_cannot(robot, kind, level, expected):
    scenario = load_calibrate(robot)
    assert (drive(scenario, kind, level, 0, scenario.trials) == PASSED) == expected


def test_a_calibration_leaves_an_ability(tmp_path):
    settings = ["trials.drives=1", "trials.halvings=2", "trials.way=0.8"]
    result = naraha("calibrate", "--robot", "pioneer", "--out", tmp_path, *(w for s in settings for w in ("--set", s)))
    assert result.returncode == 0, result.stderr
    metrics = metrics_of(tmp_path)
    assert metrics["pitch_slope_passes_rad"] <= metrics["pitch_slope_fails_rad"]
    ability = read_ability(tmp_path / "ability.yaml")
    assert ability.robot == "pioneer"
    assert "naraha calibrate --robot pioneer" in ability.source
    assert (tmp_path / "trials.csv").read_text().count("\n") == metrics["drives"] + 1


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_shipped_ability_is_passable_to_just_below_its_limits(robot):
    ability = robot_ability(robot)
    fuzzy = Mamdani(ability.fuzzy)
    limits = np.array([getattr(ability.fuzzy, name).large[1] for name in ("pitch_slope", "roll_slope", "roughness")])
    assert "naraha calibrate" in ability.source
    for i in range(3):
        inside, outside = np.zeros((2, 3))
        inside[i], outside[i] = 0.93 * limits[i], 1.02 * limits[i]
        risk = fuzzy.infer(np.array([inside, outside])).risk
        assert risk[0] < ability.risk_limit < risk[1]


@pytest.mark.parametrize("robot", ROBOTS)
def test_what_is_given_is_in_the_shipped_ability_and_can_be_set(robot):
    given, ability = load_calibrate(robot).given, robot_ability(robot)
    for name in ("footprint", "max_speed", "max_yaw_rate", "min_coverage", "risk_limit"):
        assert getattr(given, name) == getattr(ability, name)
    assert load_calibrate(robot, ["given.min_coverage=0.4"]).given.min_coverage == 0.4


def test_roughness_grows_with_the_ridges():
    rough = [measured_roughness(top, 0, TerrainConfig()) for top in (0.0, 0.05, 0.1, 0.2)]
    assert rough == sorted(rough)
    assert rough[0] < 2e-5
    assert rough[3] > 10 * rough[1]


def test_an_ability_follows_from_what_was_passed():
    scenario = load_calibrate("pioneer")
    passed = {"pitch_slope": 0.3, "roll_slope": 0.2, "step": 0.1, "ridges": 0.05}
    ability = ability_from({kind: Interval(v, 1.1 * v, HUNG, 5) for kind, v in passed.items()}, 1e-4, scenario)
    assert ability.step_threshold == 0.1
    assert ability.fuzzy.pitch_slope.large[1] == pytest.approx(0.3)
    assert ability.fuzzy.roughness.large[1] == pytest.approx(1e-4)
    assert ability.step_limit is None
    low = {kind: Interval(0.017 if kind == "step" else v, 1.1 * v, HUNG, 5) for kind, v in passed.items()}
    assert ability_from(low, 1e-4, scenario).step_limit == 0.017
    assert ability_from(low, 1e-4, scenario).step_threshold > 0.017
    middle = scenario.terrain.start + 0.5 * scenario.terrain.depth
    assert ability.height_threshold == pytest.approx(middle * np.tan(0.3) + 0.1, abs=1e-3)


def test_how_far_turns_slide_follows_from_the_measured_motions():
    # A turn of 0.8 rad on a slope of 0.3 rad slid 0.08 m and 0.16 m; what happened on the flat does not count.
    def ground(*slides, level=0.3):
        means = {"left": [slides[0], 0.0, 0.8], "right": [slides[1], 0.0, -0.8]}
        return Ground(terrain="slope", level=level, motions={name: Outcome(mean=mean) for name, mean in means.items()})

    grounds = {"slope_up": ground(-0.08, -0.16), "slope_down": ground(0.16, 0.08), "flat": ground(1.0, 1.0, level=0.0)}
    assert turn_slide(Primitives(grounds=grounds)) == round(0.12 / 0.8 / np.sin(0.3), 1)


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_shipped_ability_slides_as_its_measured_motions_do(robot):
    passed = dict.fromkeys(("pitch_slope", "roll_slope", "step", "ridges"), Interval(0.1, 0.2, HUNG, 5))
    found = ability_from(passed, 1e-4, load_calibrate(robot))
    assert found.turn_slide == robot_ability(robot).turn_slide
    assert (found.turn_slide > 0) == has_primitives(robot)


def test_an_unknown_robot_has_no_ability():
    with pytest.raises(InputError, match="no such ability"):
        robot_ability("tank")
