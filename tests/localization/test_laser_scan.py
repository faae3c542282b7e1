import dataclasses

import numpy as np
import pytest
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.localization import LaserRing, LaserScan, LaserScanError, no_scan, ring_to_laser_scan
from naraha.systems.sensing import Scan, utm30lx, vlp16
from naraha.systems.sensing.lidar import Returns, make_cloud
from pydrake.common.value import AbstractValue


def scan_of(pattern, distances, start=1.0, index=3):
    """A simulated scan in which rays 0, 1, … of `pattern` came back from `distances`, and those at infinity did not."""
    ray = np.flatnonzero(np.isfinite(distances))
    returns = Returns(ray, distances[ray].astype(np.float32), np.zeros(len(ray), np.float32))
    return Scan(make_cloud(pattern, returns), start, start + pattern.period, index)


def test_points_are_where_the_beams_ended():
    scan = LaserScan([1.0, np.inf, 2.0, 30.0], [0.0, 0.3, np.pi / 2, 1.0], 30.0, 5.0)
    np.testing.assert_allclose(scan.p_SP, [[1, 0], [0, 2]], atol=1e-12)
    np.testing.assert_array_equal(scan.returned, [True, False, True, False])  # the range itself is no return
    np.testing.assert_array_equal(scan.ages, np.zeros(4))


def test_a_scan_cannot_be_changed_from_outside():
    ranges = np.ones(3)
    scan = LaserScan(ranges, np.zeros(3), 30.0, 0.0)
    ranges[0] = 7.0
    assert scan.ranges[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        scan.ranges[0] = 2.0


@pytest.mark.parametrize(
    "wrong",
    [
        {"angles": np.zeros(2)},
        {"ranges": [1.0, np.nan, 1.0]},
        {"ranges": [1.0, -0.1, 1.0]},
        {"angles": [0.0, np.inf, 0.0]},
        {"ages": [0.0, -1.0, 0.0]},
        {"range_max": 0.0},
        {"time": np.nan},
    ],
)
def test_what_is_no_scan_is_refused(wrong):
    good = {"ranges": np.ones(3), "angles": np.zeros(3), "range_max": 30.0, "time": 0.0}
    with pytest.raises(LaserScanError, match="laser scan"):
        LaserScan(**(good | wrong))


def test_a_ring_becomes_a_scan_with_a_beam_for_every_column():
    pattern = utm30lx()
    distances = np.random.default_rng(0).uniform(0.5, 29, pattern.columns)
    distances[::7] = np.inf
    scan = ring_to_laser_scan(scan_of(pattern, distances), pattern)
    np.testing.assert_allclose(scan.ranges, distances, rtol=1e-6)
    np.testing.assert_array_equal(scan.angles, pattern.azimuths)
    assert (scan.time, scan.range_max, scan.index) == (1.025, 30.0, 3)
    # 270° of 360° are fired in the first three quarters of a revolution.
    np.testing.assert_allclose([scan.ages[0], scan.ages[-1]], [0.025, 0.25 * 0.025], atol=1e-12)


def test_a_tilted_ring_gives_the_distance_along_the_floor():
    pattern = vlp16()
    distances = np.full((pattern.rings, pattern.columns), 10.0)
    scan = ring_to_laser_scan(scan_of(pattern, distances.ravel()), pattern, ring=2)
    np.testing.assert_allclose(scan.ranges, 10 * np.cos(pattern.elevations[2]), rtol=1e-6)


def test_a_ring_that_does_not_fit_is_refused():
    pattern = utm30lx()
    short = dataclasses.replace(pattern, azimuths=pattern.azimuths[:9], times=pattern.times[:9])
    with pytest.raises(LaserScanError, match="columns 0 to 8"):
        ring_to_laser_scan(scan_of(pattern, np.ones(pattern.columns)), short)
    with pytest.raises(ConfigError, match="no such ring"):
        LaserRing(pattern, ring=1)


def test_the_system_gives_an_empty_scan_before_the_first_and_refuses_other_values():
    pattern = utm30lx()
    system = LaserRing(pattern)
    context = system.CreateDefaultContext()
    port = system.GetInputPort("scan_S")
    port.FixValue(context, AbstractValue.Make(scan_of(pattern, np.full(pattern.columns, np.inf), index=-1)))
    before = system.GetOutputPort("laser_scan").Eval(context)
    assert (len(before.ranges), before.index, before.range_max) == (0, -1, 30.0)
    port.FixValue(context, AbstractValue.Make(scan_of(pattern, np.full(pattern.columns, 2.0))))
    np.testing.assert_allclose(system.GetOutputPort("laser_scan").Eval(context).ranges, 2.0)
    port.FixValue(context, AbstractValue.Make(no_scan()))
    with pytest.raises(PortError, match="wrong type"):
        system.GetOutputPort("laser_scan").Eval(context)
