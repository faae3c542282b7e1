"""Trajectories in text files: what is written is read, and errors name file and line."""

import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from naraha.systems.errors import PoseFileError
from naraha.systems.sensing import Poses, associate, read_poses, write_tum
from scipy.spatial.transform import Rotation


def poses(count, seed=0):
    rng = np.random.default_rng(seed)
    X = np.tile(np.eye(4), (count, 1, 1))
    X[:, :3, :3] = Rotation.random(count, rng=rng).as_matrix()
    X[:, :3, 3] = rng.normal(0, 10, (count, 3))
    return X


@given(p=arrays(float, (3,), elements=st.floats(-1e4, 1e4)), seed=st.integers(0, 1000))
def test_a_tum_file_reads_as_it_was_written(p, seed, tmp_path_factory):
    path = tmp_path_factory.mktemp("tum") / "poses.txt"
    X = poses(3, seed)
    X[1, :3, 3] = p
    times = 1.63e9 + np.array([0.0, 0.1, 0.25])
    write_tum(path, times, X)
    again = read_poses(path)
    np.testing.assert_allclose(again.times, times, atol=1e-6)
    np.testing.assert_allclose(again.X_WS, X, atol=5e-9)


def test_tum_columns_are_time_position_and_quaternion_with_its_scalar_last(tmp_path):
    path = tmp_path / "tum.txt"
    path.write_text("# time x y z qx qy qz qw\n\n12.5 1 2 3 0 0 0.70710678 0.70710678\n")
    read = read_poses(path)
    assert read.times.tolist() == [12.5]
    expected = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    np.testing.assert_allclose(read.X_WS[0], expected, atol=1e-8)


def test_kitti_rows_are_the_matrix_row_by_row_and_have_no_time(tmp_path):
    path = tmp_path / "kitti.txt"
    X = poses(4)
    path.write_text("\n".join(" ".join(f"{value:.9e}" for value in pose[:3].ravel()) for pose in X))
    read = read_poses(path)
    assert read.times is None
    np.testing.assert_allclose(read.X_WS, X, atol=1e-7)


GOOD = "0 1 2 3 0 0 0 1\n"
BROKEN = {
    "word": (GOOD + "1 1 2 x 0 0 0 1\n", "line 2: not a number"),
    "columns": ("# c\n1 2 3\n", "line 2: wrong number of columns, got 3"),
    "mixed": (GOOD + "1 0 0 0 0 1 0 0 0 0 1 0\n", r"line 2: wrong number of columns, got 12 \(valid: 8\)"),
    "nan": (GOOD + "1 nan 2 3 0 0 0 1\n", "line 2: not a finite number"),
    "time": (GOOD + "0 1 2 3 0 0 0 1\n", "line 2: time does not increase"),
    "quaternion": ("0 1 2 3 0 0 0 0\n", "line 1: not a unit quaternion"),
    "matrix": ("1 0 0 0 0 1 0 0 0 0 2 0\n", "line 1: not a rotation matrix"),
    "mirror": ("1 0 0 0 0 1 0 0 0 0 -1 0\n", "line 1: not a rotation matrix"),
    "empty": ("# nothing\n", "no poses in this file"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_file_is_an_error_that_names_file_and_line(case, tmp_path):
    path = tmp_path / "poses.txt"
    content, message = BROKEN[case]
    path.write_text(content)
    with pytest.raises(PoseFileError, match=message) as caught:
        read_poses(path)
    assert str(path) in str(caught.value)


def test_a_missing_or_binary_file_is_an_error(tmp_path):
    with pytest.raises(PoseFileError, match="cannot be read"):
        read_poses(tmp_path / "nowhere.txt")
    (tmp_path / "binary.txt").write_bytes(bytes(range(256)))
    with pytest.raises(PoseFileError, match="not a text file"):
        read_poses(tmp_path / "binary.txt")


def test_what_cannot_be_written_leaves_no_file(tmp_path):
    with pytest.raises(PoseFileError, match="2 times for 3 poses"):
        write_tum(tmp_path / "a.txt", [0, 1], poses(3))
    with pytest.raises(PoseFileError, match="cannot be written"):
        write_tum(tmp_path / "no" / "a.txt", [0, 1, 2], poses(3))
    assert os.listdir(tmp_path) == []


def test_as_many_poses_as_scans_belong_together_by_index():
    X = poses(5)
    scans, found = associate(Poses(None, X), 5)
    np.testing.assert_array_equal(scans, np.arange(5))
    np.testing.assert_array_equal(found, X)


def test_other_counts_go_by_the_nearest_time():
    X = poses(4)
    recorded = Poses(np.array([0.0, 1.0, 2.0, 3.0]), X)
    scans, found = associate(recorded, 6, np.array([-0.04, 0.5, 0.96, 2.04, 3.04, 9.0]))
    np.testing.assert_array_equal(scans, [0, 2, 3, 4])
    np.testing.assert_array_equal(found, X)


def test_one_pose_finds_its_scan():
    scans, _ = associate(Poses(np.array([1.0]), poses(1)), 3, np.array([0.0, 1.01, 2.0]))
    np.testing.assert_array_equal(scans, [1])


def test_poses_that_cannot_be_assigned_are_an_error():
    timed, untimed = Poses(np.arange(3.0), poses(3)), Poses(None, poses(3))
    with pytest.raises(PoseFileError, match=r"truth.txt: 3 poses for 4 scans, and the scans have no times"):
        associate(timed, 4, where="truth.txt")
    with pytest.raises(PoseFileError, match=r"3 poses for 4 scans, and the poses have no times"):
        associate(untimed, 4, np.arange(4.0))
    with pytest.raises(PoseFileError, match=r"none within 0.05 s"):
        associate(timed, 4, 100 + np.arange(4.0))
