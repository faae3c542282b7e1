import bz2

import numpy as np
import pytest
from naraha.systems.localization import CarmenLogError, read_carmen_log

LOG = """# CARMEN Logfile
PARAM robot_width 0.5 nohost 0
ODOM 1.0 2.0 0.5 0 0 0 1211.5 host 0.01
FLASER 4 1.5 2.0 81.83 0.5 1.1 2.0 0.0 1.0 2.0 0.0 1211.520329 host 0.25
FLASER 4 1.4 2.0 81.83 0.5 1.3 2.0 0.1 1.2 2.0 0.1 1211.720330 host 0.50
"""


@pytest.mark.parametrize("packed", [False, True])
def test_scans_and_odometry_are_those_of_the_lines(tmp_path, packed):
    path = tmp_path / ("log.clf.bz2" if packed else "log.clf")
    path.write_bytes(bz2.compress(LOG.encode()) if packed else LOG.encode())
    log = read_carmen_log(path)
    assert [scan.time for scan in log.scans] == [0.25, 0.5]
    assert [scan.index for scan in log.scans] == [0, 1]
    np.testing.assert_array_equal(log.scans[0].ranges, [1.5, 2.0, np.inf, 0.5])
    np.testing.assert_allclose(np.degrees(log.scans[0].angles), [-90, -45, 0, 45])
    np.testing.assert_array_equal(log.odometry, [[1.0, 2.0, 0.0], [1.2, 2.0, 0.1]])
    np.testing.assert_allclose(log.X_BS, [0.1, 0, 0], atol=1e-12)


def test_so_many_scans_are_read_as_asked_for(tmp_path):
    (tmp_path / "log.clf").write_text(LOG)
    assert len(read_carmen_log(tmp_path / "log.clf", most=1).scans) == 1


def test_an_odd_number_of_beams_has_one_straight_ahead(tmp_path):
    (tmp_path / "log.clf").write_text("FLASER 5 1 1 1 1 1 0 0 0 0 0 0 7 host 0.1\n")
    np.testing.assert_allclose(
        np.degrees(read_carmen_log(tmp_path / "log.clf").scans[0].angles), [-90, -45, 0, 45, 90], atol=1e-9
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("ODOM 1 2 3\n", "holds no scan"),
        ("FLASER 4 1 1\n", "line 1: broken line"),
        ("# a comment\nFLASER 2 1 -1 0 0 0 0 0 0 7 host 0.1\n", "line 2: broken line"),
        ("FLASER 2 1 x 0 0 0 0 0 0 7 host 0.1\n", "line 1: broken line"),
        ("FLASER 2 1 nan 0 0 0 0 0 0 7 host 0.1\n", "line 1: broken line"),
    ],
)
def test_a_broken_log_is_refused_with_its_line(tmp_path, text, message):
    (tmp_path / "log.clf").write_text(text)
    with pytest.raises(CarmenLogError, match=message):
        read_carmen_log(tmp_path / "log.clf")


def test_files_that_are_missing_or_not_packed_are_refused(tmp_path):
    with pytest.raises(CarmenLogError, match="no such file"):
        read_carmen_log(tmp_path / "none.clf")
    (tmp_path / "log.clf.bz2").write_text(LOG)
    with pytest.raises(CarmenLogError, match="cannot be read"):
        read_carmen_log(tmp_path / "log.clf.bz2")
