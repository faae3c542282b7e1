"""Replay of recorded scans: one a period, in order, and broken ones do not stop it."""

import numpy as np
import pytest
from naraha.systems.errors import ConfigError
from naraha.systems.sensing import Scan, ScanReplay
from pydrake.systems.analysis import Simulator


@pytest.fixture
def scans(tmp_path):
    """Six files whose scan i has i + 1 points; number 2 is truncated and number 4 has no usable point."""
    paths = [tmp_path / f"{i}.npz" for i in range(6)]
    for i, path in enumerate(paths):
        np.savez(path, xyz=np.full((i + 1, 3), np.nan if i == 4 else float(i)))
    paths[2].write_bytes(paths[2].read_bytes()[:100])
    return paths


def at(simulator, time):
    """Runs to `time`; what is due at that very moment is not done yet."""
    simulator.AdvanceTo(time)
    context = simulator.get_context()
    system = simulator.get_system()
    return (
        system.GetOutputPort("scan_S").Eval(context),
        system.GetOutputPort("scans_skipped").Eval(context)[0],
        system.GetOutputPort("skipped").Eval(context),
    )


def test_before_the_first_update_there_is_an_empty_scan(scans):
    replay = ScanReplay(scans)
    scan = replay.GetOutputPort("scan_S").Eval(replay.CreateDefaultContext())
    assert isinstance(scan, Scan)
    assert scan.index == -1
    assert scan.p_SP.shape == (0, 3)


def test_scans_come_one_a_period_with_their_place_in_the_list(scans):
    simulator = Simulator(ScanReplay(scans, period=0.5))
    seen = [at(simulator, 0.5 * i + 0.25) for i in range(8)]
    assert [scan.index for scan, _, _ in seen] == [0, 1, 1, 3, 3, 5, 5, 5]
    assert [len(scan.p_SP) for scan, _, _ in seen] == [1, 2, 2, 4, 4, 6, 6, 6]
    assert [scan.end_time for scan, _, _ in seen] == pytest.approx([0, 0.5, 0.5, 1.5, 1.5, 2.5, 2.5, 2.5])
    assert all(scan.start_time == scan.end_time for scan, _, _ in seen)
    assert simulator.get_system().duration == 3.0


def test_scans_that_cannot_be_read_are_counted_and_remembered_with_the_reason(scans):
    simulator = Simulator(ScanReplay(scans, period=0.5))
    assert [at(simulator, 0.5 * i + 0.25)[1] for i in range(6)] == [0, 0, 1, 1, 2, 2]
    skipped = at(simulator, 3.0)[2]
    assert len(skipped) == 2
    assert str(scans[2]) in skipped[0]
    assert "none of its 5 points is finite" in skipped[1]


def test_recorded_times_become_the_ends_of_the_scans(scans):
    simulator = Simulator(ScanReplay(scans, times=100 + np.arange(6.0), period=0.5))
    assert at(simulator, 0.25)[0].end_time == 100
    assert at(simulator, 2.75)[0].end_time == 105


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("time", np.array([0.0, 0.04, 0.1], np.float32)),
        ("t", np.array([-0.1, -0.06, 0.0])),
        ("timestamp", 1e6 + np.array([0.0, 0.04, 0.1])),
        ("t", np.array([7_000_000, 47_000_000, 107_000_000], np.uint32)),
    ],
)
def test_times_of_the_points_become_seconds_since_the_start_of_the_scan(name, values, tmp_path):
    np.savez(tmp_path / "a.npz", xyz=np.eye(3), **{name: values})
    scan, _, _ = at(Simulator(ScanReplay([tmp_path / "a.npz"], times=[5.0])), 0.05)
    assert scan.end_time == 5.0
    assert scan.start_time == pytest.approx(4.9)
    np.testing.assert_allclose(scan.attribute("time"), [0, 0.04, 0.1], atol=1e-6)
    assert scan.cloud_S.point["time"].shape == (3, 1)


def test_a_time_column_that_cannot_be_in_seconds_skips_the_scan(tmp_path):
    np.savez(tmp_path / "a.npz", xyz=np.eye(3), t=np.array([0.0, 40.0, 100.0]))
    scan, count, skipped = at(Simulator(ScanReplay([tmp_path / "a.npz"])), 0.05)
    assert scan.index == -1
    assert count == 1
    assert "t: times of the points span too long, got 100.0" in skipped[0]


def test_arguments_that_make_no_sense_are_errors(scans):
    with pytest.raises(ConfigError, match="paths: nothing to replay"):
        ScanReplay([])
    for period in (0.0, -1.0, np.nan):
        with pytest.raises(ConfigError, match="period: out of range"):
            ScanReplay(scans, period=period)
    with pytest.raises(ConfigError, match=r"times: must be one a scan, got 2 \(valid: 6\)"):
        ScanReplay(scans, times=[0.0, 1.0])
