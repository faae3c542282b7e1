"""`naraha merge` as a user runs it, and what it leaves."""

import json
import subprocess
import sys

import numpy as np
import pytest
from naraha.systems.sensing import read_poses, read_scan, write_cloud, write_tum

from tests.viewpoints.viewpoints import box_room, cloud_of

PRODUCTS = ["metrics.json", "recording.html", "scenario.yaml", "survey_map.ply", "trajectory.txt"]


def naraha(*arguments, cwd=None):
    command = [sys.executable, "-m", "naraha.diagrams", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=300, check=False)


def metrics_of(folder):
    return json.loads((folder / "metrics.json").read_text())


@pytest.fixture
def views(tmp_path):
    """Three views of one room, 4 m and more apart, and the true poses."""
    folder = tmp_path / "views"
    folder.mkdir()
    rng = np.random.default_rng(0)
    poses = []
    for i, (p, yaw) in enumerate((((-2.5, 0.5), 0.3), ((2.0, -1.5), 2.0), ((-0.5, 2.0), -2.5))):
        points, X_WS = box_room(rng, p=p, yaw=yaw, crate=True)
        write_cloud(folder / f"{i}.ply", cloud_of(points))
        poses.append(X_WS.GetAsMatrix4())
    write_tum(tmp_path / "truth.txt", np.arange(3.0), np.array(poses))
    return folder, tmp_path / "truth.txt"


def test_views_are_joined_and_compared(views, tmp_path):
    folder, truth = views
    result = naraha("merge", folder, "--truth", truth, "--out", tmp_path / "out")
    assert result.returncode == 0, result.stderr
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == PRODUCTS
    metrics = metrics_of(tmp_path / "out")
    assert metrics["status"] == "done"
    assert metrics["views"] == metrics["views_joined"] == 3
    assert 0 < metrics["view_error_max_m"] < 0.02
    assert 0 < metrics["view_error_max_deg"] < 0.2
    poses = read_poses(tmp_path / "out" / "trajectory.txt")
    np.testing.assert_allclose(poses.times, [0, 1, 2])
    points = read_scan(tmp_path / "out" / "survey_map.ply").point.positions.numpy()
    assert np.ptp(points[:, :2], axis=0).max() < 12  # one room, not three


def test_what_cannot_be_joined_is_named_and_the_rest_is_mapped(views, tmp_path):
    folder, _ = views
    (folder / "1.ply").write_text("hello")
    rng = np.random.default_rng(1)
    write_cloud(folder / "2.ply", cloud_of(rng.uniform(-4, 4, (20000, 3))))
    room, _ = box_room(rng, p=(1.0, 1.0), yaw=1.0, crate=True)
    write_cloud(folder / "3.ply", cloud_of(room))
    result = naraha("merge", folder, "--out", tmp_path / "out")
    assert result.returncode == 0, result.stderr
    assert "skipped: " in result.stderr
    assert "1.ply" in result.stderr
    assert "left out: 2.ply: " in result.stderr
    metrics = metrics_of(tmp_path / "out")
    assert (metrics["views"], metrics["views_joined"], metrics["views_skipped"]) == (4, 2, 1)
    assert "view_error_max_m" not in metrics


def test_views_that_do_not_fit_fail_the_mission_but_leave_its_products(views, tmp_path):
    folder, _ = views
    for path in folder.iterdir():
        path.unlink()
    rng = np.random.default_rng(0)
    for i, p in enumerate(((-2.5, 0.5), (2.0, -1.5))):  # an empty room, which fits itself turned by 180°
        write_cloud(folder / f"{i}.ply", cloud_of(box_room(rng, p=p, yaw=1.0 + i)[0]))
    result = naraha("merge", folder, "--out", tmp_path / "out")
    assert result.returncode == 1
    assert "fits in two ways" in result.stderr
    assert metrics_of(tmp_path / "out")["views_joined"] == 1
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == PRODUCTS


def bad_truth(folder):
    (folder.parent / "truth.txt").write_text("0 0 0 0 0 0 0 1\n")


BAD_INPUT = {
    "missing folder": (lambda folder: folder.rename(folder.parent / "elsewhere"), [], "no such file or folder"),
    "one view": (lambda folder: [(folder / f"{i}.ply").unlink() for i in (1, 2)], [], "number of views, got 1"),
    "no view can be read": (
        lambda folder: [(folder / f"{i}.ply").write_text("x") for i in range(3)],
        [],
        "0.ply",
    ),
    "truth that does not fit": (bad_truth, ["--truth", "truth.txt"], "truth.txt"),
    "bad setting": (lambda folder: None, ["--set", "merger.merge.search.peaks=0"], "merger.merge.search.peaks"),
    "no stage": (
        lambda folder: None,
        ["--set", "merger.merge.refinement.max_distances=[]"],
        "refinement.max_distances",
    ),
}


@pytest.mark.parametrize("case", BAD_INPUT)
def test_bad_input_is_one_line_exit_code_2_and_no_file(case, views, tmp_path):
    prepare, arguments, message = BAD_INPUT[case]
    prepare(views[0])
    result = naraha("merge", "views", "--out", "result", *arguments, cwd=tmp_path)
    assert result.returncode == 2
    assert result.stderr.startswith("naraha: ")
    assert message in result.stderr
    assert result.stderr.count("\n") == 1
    assert not (tmp_path / "result").exists()
