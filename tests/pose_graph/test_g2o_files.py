"""Reading and writing .g2o files."""

import numpy as np
import pytest
from naraha.systems.pose_graph import LOOP, ODOMETRY, PoseGraphError, chi_squared, read_g2o, write_g2o

from tests.pose_graph.false_loops import laps

SQUARE = """\
# a comment
VERTEX_SE2 10 0 0 0
VERTEX_SE2 20 1 0 1.5
FIX 10
EDGE_SE2 10 20 1 0.5 0.25 1 2 3 40 5 60

EDGE_SE2 20 10 -1 0 0 10 0 0 20 0 30
"""


@pytest.mark.parametrize("planar", [False, True])
def test_what_was_written_is_read_back(tmp_path, planar):
    graph, _ = laps(1, steps=10, planar=planar)
    write_g2o(tmp_path / "graph.g2o", graph)
    again = read_g2o(tmp_path / "graph.g2o")
    assert again.planar == planar
    np.testing.assert_array_equal(again.i, graph.i)
    np.testing.assert_array_equal(again.kind, graph.kind)
    np.testing.assert_allclose(again.poses, graph.poses, atol=1e-12)
    np.testing.assert_allclose(again.X_ij, graph.X_ij, atol=1e-12)
    used = [2, 3, 4] if planar else range(6)
    np.testing.assert_array_equal(again.information[:, used][:, :, used], graph.information[:, used][:, :, used])
    np.testing.assert_allclose(chi_squared(again), chi_squared(graph), rtol=1e-9, atol=1e-9)


def test_orders_of_a_planar_file(tmp_path):
    path = tmp_path / "square.g2o"
    path.write_text(SQUARE)
    graph = read_g2o(path)
    assert graph.i.tolist() == [0, 1]
    assert graph.kind.tolist() == [ODOMETRY, LOOP]
    # Yaw first in ours, last in the file.
    np.testing.assert_array_equal(graph.information[0][2:5, 2:5], [[60, 3, 5], [3, 1, 2], [5, 2, 40]])
    np.testing.assert_allclose(graph.X_ij[0, :3, 3], [1, 0.5, 0])
    assert np.arctan2(graph.X_ij[0, 1, 0], graph.X_ij[0, 0, 0]) == pytest.approx(0.25)


def test_a_file_without_poses_gets_those_of_its_odometry(tmp_path):
    path = tmp_path / "edges.g2o"
    rows = [line for line in SQUARE.splitlines() if line.startswith("EDGE")]
    path.write_text("\n".join(rows))
    np.testing.assert_allclose(read_g2o(path).poses[1], read_g2o(path).X_ij[0])


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("FIX 10", "EDGE_XY 1 2", r"bad.g2o: line 4: unknown tag, got 'EDGE_XY' .valid: VERTEX_SE2"),
        ("5 60", "5", r"bad.g2o: line 5: wrong number of words, got 11 .valid: 12"),
        ("VERTEX_SE2 20 1", "VERTEX_SE2 20 one", r"bad.g2o: line 3: not a number"),
        ("VERTEX_SE2 20 1", "VERTEX_SE2 20 nan", r"bad.g2o: line 3: not a finite number"),
        ("VERTEX_SE2 20", "VERTEX_SE2 10", r"bad.g2o: line 3: pose given twice, got 10"),
        ("EDGE_SE2 20 10", "EDGE_SE2 20 30", r"bad.g2o: line 7: no such pose, got 30"),
        ("EDGE_SE2 20 10", "EDGE_SE2 20 20", r"bad.g2o: line 7: an edge from a pose to itself"),
        ("0 0 20", "0 0 -20", r"bad.g2o: line 7: the information is not positive definite"),
        ("FIX 10", "VERTEX_SE3:QUAT 3 0 0 0 0 0 0 1", r"bad.g2o: line 4: SE2 and SE3 in one file"),
        ("FIX 10", "VERTEX_SE3:QUAT 3 0 0 0 0 0 1 1", r"bad.g2o: line 4: not a unit quaternion"),
    ],
)
def test_errors_name_file_and_line(tmp_path, old, new, problem):
    path = tmp_path / "bad.g2o"
    path.write_text(SQUARE.replace(old, new))
    with pytest.raises(PoseGraphError, match=problem):
        read_g2o(path)


def test_what_is_no_file_or_holds_nothing_is_said(tmp_path):
    with pytest.raises(PoseGraphError, match=r"nothing.g2o: cannot be read"):
        read_g2o(tmp_path / "nothing.g2o")
    (tmp_path / "empty.g2o").write_text("\n")
    with pytest.raises(PoseGraphError, match="no pose and no edge"):
        read_g2o(tmp_path / "empty.g2o")
    graph, _ = laps(1, steps=10)
    with pytest.raises(PoseGraphError, match="cannot be written"):
        write_g2o(tmp_path / "no folder" / "graph.g2o", graph)


def test_a_published_file_has_the_published_error(shared_data):
    graph = read_g2o(shared_data / "g2o" / "sphere2500.g2o")
    assert (len(graph.poses), len(graph.i), len(graph.loops)) == (2500, 4949, 2450)
    assert chi_squared(graph).sum() == pytest.approx(2.6113e6, rel=1e-4)
