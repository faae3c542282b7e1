"""The missions as a user runs them: the command in a process of its own, and what it leaves."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import open3d as o3d
import pytest
from naraha.systems.sensing import read_poses, read_scan, write_cloud

SHORT_TOUR = "tour.waypoints=[{xy: [-7.2, -5.0]}]"
LOOK_TOUR = "tour.waypoints=[{xy: [-6.2, -3.9], look_deg: [45]}]"
PRODUCTS = ["metrics.json", "scenario.yaml", "recording.html", "survey_map.ply", "trajectory.txt"]
MAP_PRODUCTS = [*PRODUCTS, "survey_map.bt", "survey_map.ot"]
SURVEY_PRODUCTS = [*MAP_PRODUCTS, "survey_seen.npz", "odometry.txt", "truth.txt"]
VARYING = {"wall_time_s", "realtime_factor", "peak_rss_mb"}


def naraha(*arguments, cwd=None, timeout=300):
    command = [sys.executable, "-m", "naraha.diagrams", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=timeout, check=False)


def metrics_of(folder):
    return json.loads((folder / "metrics.json").read_text())


@pytest.fixture(scope="module")
def short_survey(tmp_path_factory):
    out = tmp_path_factory.mktemp("survey")
    # Without mirror images, which are outside of the walls as long as nobody has looked at the water that shows them.
    settings = ["--set", SHORT_TOUR, "--set", "lidar.mirror=false"]
    result = naraha("survey", "stair_hall", "--out", out, "--seed", 1, *settings)
    return result, out


def test_a_survey_ends_well_and_leaves_every_product(short_survey):
    result, out = short_survey
    assert result.returncode == 0, result.stderr
    assert sorted(p.name for p in out.iterdir()) == sorted(SURVEY_PRODUCTS)
    metrics = metrics_of(out)
    assert metrics["status"] == "done"
    assert metrics["seed"] == 1
    assert metrics["waypoints_reached"] == 1
    assert 0 < metrics["trajectory_error_mean_m"] < 0.05
    assert 0 < metrics["map_error_m"] < 0.05
    assert metrics["scans"] > 10
    assert metrics["scans_skipped"] == 0
    for key in ("reason", "sim_time_s", "wall_time_s", "realtime_factor", "peak_rss_mb", "odometry_map_error_m"):
        assert key in metrics
    assert all(not isinstance(value, (dict, list)) for value in metrics.values())


def test_the_map_has_the_hall_and_the_attributes(short_survey):
    cloud = read_scan(short_survey[1] / "survey_map.ply")
    points = cloud.point.positions.numpy()
    assert len(points) > 5000
    assert "intensity" in cloud.point
    assert np.abs(points[:, 0]).max() < 10.3
    assert np.abs(points[:, 1]).max() < 7.3
    floor = points[np.abs(points[:, 2]) < 0.05]
    assert len(floor) > 500


def test_the_trajectory_ends_at_the_waypoint(short_survey):
    poses = read_poses(short_survey[1] / "trajectory.txt")
    np.testing.assert_allclose(poses.X_WS[0, :2, 3], [-8, -5], atol=0.02)
    np.testing.assert_allclose(poses.X_WS[-1, :2, 3], [-7.2, -5], atol=0.15)
    assert (np.diff(poses.times) > 0).all()


def test_a_resolved_scenario_repeats_the_run_and_another_seed_does_not(short_survey, tmp_path):
    first = metrics_of(short_survey[1])
    assert naraha("survey", short_survey[1] / "scenario.yaml", "--out", tmp_path / "again").returncode == 0
    again = metrics_of(tmp_path / "again")
    assert {k: v for k, v in first.items() if k not in VARYING} == {k: v for k, v in again.items() if k not in VARYING}
    assert naraha("survey", "stair_hall", "--out", tmp_path / "other", "--seed", 2, "--set", SHORT_TOUR).returncode == 0
    assert metrics_of(tmp_path / "other")["trajectory_error_mean_m"] != first["trajectory_error_mean_m"]


@pytest.fixture(scope="module")
def looked(tmp_path_factory):
    """A survey up to the first look at a pool."""
    out = tmp_path_factory.mktemp("looked")
    settings = ["--set", LOOK_TOUR, "--set", "tour.look_time=8", "--set", "baseline=null"]
    result = naraha("survey", "stair_hall", "--out", out, *settings)
    assert result.returncode == 0, result.stderr
    return out


def test_a_survey_finds_the_pool_that_it_looks_at_and_nothing_else(looked):
    metrics = metrics_of(looked)
    assert metrics["puddles_found"] == 1
    assert metrics["puddles_false"] == 0
    assert metrics["water_iou"] > 0.8
    assert metrics["water_points"] > 30
    assert metrics["dose_map_error"] < 0.3
    assert metrics["hot_spots"] == 0


def test_the_points_of_the_map_carry_what_was_measured(looked):
    cloud = read_scan(looked / "survey_map.ply")
    values = {name: cloud.point[name].numpy()[:, 0] for name in ("nir", "temperature", "dose_rate", "intensity")}
    label = cloud.point["label"].numpy()[:, 0]
    points = cloud.point.positions.numpy()
    in_pool = np.hypot(points[:, 0] + 5.0, points[:, 1] + 2.6) < 0.3
    assert (label[in_pool & (np.abs(points[:, 2]) < 0.1)] == 1).mean() > 0.9
    assert set(np.unique(label)) <= {0, 1}
    assert np.nanmedian(values["nir"][in_pool]) < 0.05
    assert 0.25 < np.nanmedian(values["nir"][np.abs(points[:, 2]) < 0.05]) < 0.45  # mostly concrete
    assert np.nanmedian(values["temperature"]) == pytest.approx(20, abs=2)
    for name in ("nir", "temperature", "intensity"):  # what was never seen is not known
        assert 0 < np.isnan(values[name]).mean() < 1
    assert (values["dose_rate"] > 0).all()


def test_the_recording_has_layers_and_a_legend(looked):
    page = (looked / "recording.html").read_text()
    assert 'id="layer-panel"' in page
    for title in ("near infrared", "temperature", "dose rate", "water"):
        assert title in page


def test_a_later_survey_says_what_has_changed(looked, tmp_path):
    later = ["--set", "world.name=stair_hall_later", "--earlier", looked, "--set", LOOK_TOUR]
    settings = [*later, "--set", "tour.look_time=3", "--set", "baseline=null"]
    result = naraha("survey", "stair_hall", "--out", tmp_path, *settings)
    assert result.returncode == 0, result.stderr
    metrics = metrics_of(tmp_path)
    assert metrics["update_valid"] == 1
    assert metrics["changes_found"] >= 5
    assert metrics["changes_precision"] > 0.8
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([*SURVEY_PRODUCTS, "changes.csv"])
    lines = (tmp_path / "changes.csv").read_text().splitlines()
    assert lines[0].startswith("change,centre_x_m")
    assert len(lines) == 1 + metrics["changes_reported"]
    assert {line.split(",")[0] for line in lines[1:]} <= {"appeared", "vanished"}
    change = read_scan(tmp_path / "survey_map.ply").point["change"].numpy()
    assert metrics["points_unchanged"] > 1000
    assert set(np.unique(change)) == {0, 1, 2, 3, 4}


@pytest.mark.parametrize("name", ["corridor", "rough"])
def test_every_other_shipped_survey_runs(name, tmp_path):
    result = naraha("survey", name, "--out", tmp_path, "--set", "duration=4")
    assert result.returncode == 0, result.stderr
    assert metrics_of(tmp_path)["sim_time_s"] == 4


def test_a_stuck_robot_fails_the_mission_but_keeps_what_was_measured(tmp_path):
    wall = "[{xy: [-12.0, -5.0]}]"
    result = naraha("survey", "stair_hall", "--out", tmp_path, "--set", f"tour.waypoints={wall}", "--set", "patience=3")
    assert result.returncode == 1
    metrics = metrics_of(tmp_path)
    assert metrics["status"] == "failed"
    assert "stuck on the way to waypoint 1 of 1" in metrics["reason"]
    assert all((tmp_path / product).exists() for product in MAP_PRODUCTS)


def test_ctrl_c_stops_cleanly_and_keeps_what_was_measured(tmp_path):
    command = [sys.executable, "-m", "naraha.diagrams", "survey", "--out", str(tmp_path), "--realtime-rate", "1"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    time.sleep(12)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 130, errors
    metrics = metrics_of(tmp_path)
    assert metrics["status"] == "interrupted"
    assert metrics["sim_time_s"] > 0
    assert all((tmp_path / product).exists() for product in MAP_PRODUCTS)


BAD_SURVEYS = {
    "unknown scenario": (["nowhere"], "no such scenario or file"),
    "unknown key": (["--set", "lidar.rnge=3"], "lidar.rnge: unknown key"),
    "unknown robot": (["--set", "robot.model=tank"], "unknown robot, got 'tank' (valid: amphibious, crawler"),
    "unknown world": (["--set", "world.name=moon"], "unknown world, got 'moon'"),
    "negative period": (["--set", "slam.period=-0.1"], "slam.period: out of range, got -0.1"),
    "zero time step": (["--set", "plant.time_step=0"], "plant.time_step: out of range"),
    "no waypoint": (["stair_hall", "--set", "tour.waypoints=[]"], "tour.waypoints: no waypoints"),
    "no ground at the start": (["--set", "robot.start_xyz=[50, 0, 0.1]"], "no ground below the robot's start"),
    "unknown flipper preset": (["--set", "tour.waypoints=[{xy: [0, 0], flippers: up}]"], "flippers"),
    "negative seed": (["--seed", "-1"], "--seed"),
    "output that is a file": (["--out", "bad.yaml"], "--out bad.yaml: not a folder"),
    "not YAML": (["bad.yaml"], "bad.yaml: not YAML"),
    "no earlier survey": (["--earlier", "nowhere"], "nowhere: no such folder"),
    "earlier survey without a map": (["--earlier", "."], "survey_map.ply: no such file"),
    "pan-tilt range": (["--set", "head.pan_tilt.tilt_range_deg=[60, -30]"], "tilt_range_deg: range, got [60"),
    "field of view": (["--set", "head.nir_camera.fov_x_deg=0"], "head.nir_camera.fov_x_deg: out of range"),
    "distortion": (["--set", "head.depth_camera.distortion=[1, 2]"], "distortion: wrong length"),
    "unknown sweep": (["--set", "fusion.sweep.tilt_range_deg=[80, 90]"], "no row of the sweep is left"),
    "world without ground": (["--set", "world.name=floating.yaml"], "floating.yaml: the world has no ground"),
}


@pytest.mark.parametrize("case", BAD_SURVEYS)
def test_bad_input_is_one_line_exit_code_2_and_no_file(case, tmp_path):
    arguments, message = BAD_SURVEYS[case]
    (tmp_path / "bad.yaml").write_text("world: [")
    (tmp_path / "floating.yaml").write_text(
        "surfaces: {a: {label: wall}}\nsolids: [{name: slab, box: [9, 9, 1], surface: a}]"
    )
    result = naraha("survey", "--out", "result", *arguments, cwd=tmp_path)
    assert result.returncode == 2
    assert message in result.stderr
    assert "Traceback" not in result.stderr
    if case != "negative seed":  # that one is the command line's own message
        assert result.stderr.startswith("naraha: ")
        assert result.stderr.count("\n") == 1
    assert not (tmp_path / "result").exists()


def box_scan(rng, shift):
    """Points of a room of 8 × 6 × 3 m as seen from (shift, 0, 1)."""
    points = rng.uniform([-4, -3, 0], [4, 3, 3], (6000, 3))
    face = rng.integers(0, 3, len(points))
    side = rng.integers(0, 2, len(points)).astype(float)
    points[face == 0, 0] = -4 + 8 * side[face == 0]
    points[face == 1, 1] = -3 + 6 * side[face == 1]
    points[face == 2, 2] = 3 * side[face == 2]
    return o3d.t.geometry.PointCloud((points - [shift, 0, 1]).astype(np.float32))


@pytest.fixture
def scans(tmp_path):
    folder = tmp_path / "scans"
    folder.mkdir()
    rng = np.random.default_rng(0)
    for i in range(5):
        write_cloud(folder / f"{i}.ply", box_scan(rng, 0.1 * i))
    truth = tmp_path / "truth.txt"
    truth.write_text("".join(f"{i} {0.1 * i} 0 1 0 0 0 1\n" for i in range(5)))
    return folder, truth


def test_recorded_scans_are_mapped_and_compared(scans, tmp_path):
    folder, truth = scans
    result = naraha("map", folder, "--truth", truth, "--out", tmp_path / "out")
    assert result.returncode == 0, result.stderr
    metrics = metrics_of(tmp_path / "out")
    assert metrics["scans"] == metrics["scans_mapped"] == 5
    assert metrics["scans_skipped"] == 0
    assert metrics["trajectory_error_mean_m"] < 0.02
    assert metrics["map_error_m"] < 0.05
    assert metrics["path_length_m"] == pytest.approx(0.4, abs=0.05)
    assert all((tmp_path / "out" / product).exists() for product in MAP_PRODUCTS)


def test_a_broken_scan_in_the_middle_is_skipped_counted_and_reported(scans, tmp_path):
    folder, truth = scans
    whole = (folder / "2.ply").read_bytes()
    (folder / "2.ply").write_bytes(whole[: len(whole) // 2])
    result = naraha("map", folder, "--truth", truth, "--out", tmp_path / "out")
    assert result.returncode == 0, result.stderr
    metrics = metrics_of(tmp_path / "out")
    assert metrics["scans_skipped"] == 1
    assert metrics["scans_mapped"] == 4
    assert metrics["trajectory_error_mean_m"] < 0.02
    assert "2.ply" in result.stderr


BAD_SCANS = {
    "missing": lambda folder: None,
    "empty folder": lambda folder: folder.mkdir(),
    "no points": lambda folder: (folder.mkdir(), np.savez(folder / "a.npz", xyz=np.zeros((0, 3), np.float32))),
    "only NaN": lambda folder: (folder.mkdir(), np.savez(folder / "a.npz", xyz=np.full((9, 3), np.nan, np.float32))),
    "truncated": lambda folder: (
        folder.mkdir(),
        write_cloud(folder / "a.ply", box_scan(np.random.default_rng(0), 0)),
        os.truncate(folder / "a.ply", 5000),
    ),
    "not a scan": lambda folder: (folder.mkdir(), (folder / "a.ply").write_text("hello")),
}


@pytest.mark.parametrize("case", BAD_SCANS)
def test_bad_scans_are_one_line_exit_code_2_and_no_file(case, tmp_path):
    BAD_SCANS[case](tmp_path / "scans")
    result = naraha("map", "scans", "--out", "result", cwd=tmp_path)
    assert result.returncode == 2
    assert result.stderr.startswith("naraha: scans")
    assert result.stderr.count("\n") == 1
    assert not (tmp_path / "result").exists()


def test_truth_that_does_not_fit_is_refused(scans, tmp_path):
    folder, truth = scans
    truth.write_text("0 0 0 0 0 0 0 1\n")
    result = naraha("map", folder, "--truth", truth, "--out", tmp_path / "result")
    assert result.returncode == 2
    assert "truth.txt" in result.stderr
    assert not (tmp_path / "result").exists()
