"""Beams of the LiDARs, on paper and against rotations of a real VLP-16."""

from pathlib import Path

import numpy as np
import pytest
from naraha.systems.errors import ConfigError
from naraha.systems.sensing import LidarConfig, ScanPattern, utm30lx, utm30lx_10hz, vlp16

ROTATIONS = Path(__file__).parents[3] / "shared" / "data" / "nebula"


def pattern(**changes):
    arguments = {
        "elevations": np.radians([-10, 0, 10]),
        "azimuths": np.radians([0, 90, 180, 270]),
        "times": np.array([0, 0.1, 0.2, 0.3]),
        "period": 0.4,
        "min_range": 0.1,
        "max_range": 50.0,
        "range_noise": 0.01,
        "detection_range": 60.0,
    }
    return ScanPattern(**(arguments | changes))


def test_rays_are_in_ring_major_order():
    p = pattern()
    assert (p.rings, p.columns, p.rays) == (3, 4, 12)
    np.testing.assert_array_equal(p.ring, [0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2])
    np.testing.assert_array_equal(p.column, [0, 1, 2, 3] * 3)
    np.testing.assert_array_equal(p.time, np.float32([0, 0.1, 0.2, 0.3] * 3))
    assert (p.ring.dtype, p.column.dtype, p.time.dtype) == (np.uint8, np.uint16, np.float32)


def test_directions_are_unit_vectors_of_their_elevation_and_azimuth():
    d = pattern().d_S
    e = np.radians(10)
    np.testing.assert_allclose(d[0], [np.cos(e), 0, -np.sin(e)], atol=1e-7)
    np.testing.assert_allclose(d[5], [0, 1, 0], atol=1e-7)
    np.testing.assert_allclose(d[10], [-np.cos(e), 0, np.sin(e)], atol=1e-7)
    assert d.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1, rtol=1e-6)


def test_beams_start_on_the_axis_at_the_height_of_their_ring():
    heights = np.array([0.01, 0, -0.01])
    np.testing.assert_allclose(pattern(heights=heights).p_SR[[0, 4, 11]], np.outer(heights, [0, 0, 1]), atol=1e-9)
    assert not pattern().p_SR.any()


def test_vlp16_has_28800_rays_over_a_tenth_of_a_second():
    p = vlp16()
    assert (p.rings, p.columns, p.rays) == (16, 1800, 28800)
    np.testing.assert_allclose(np.degrees(p.elevations), np.arange(-15, 16, 2))
    np.testing.assert_allclose(np.diff(np.degrees(p.azimuths)), -0.2)
    np.testing.assert_allclose(np.diff(p.times), 0.1 / 1800)
    assert (p.period, p.min_range, p.max_range, p.range_noise) == (0.1, 0.4, 100.0, 0.008)
    np.testing.assert_allclose(p.heights, -p.heights[::-1])


def test_at_10_hz_a_utm30lx_sweeps_as_fast_as_ever_and_last_thing_in_the_period():
    p, full = utm30lx_10hz(), utm30lx()
    assert p.period == 0.1
    np.testing.assert_allclose(np.diff(p.times), np.diff(full.times))
    assert 0.1 - p.times[-1] == pytest.approx(full.period - full.times[-1])
    np.testing.assert_array_equal(p.azimuths, full.azimuths)


def test_utm30lx_sweeps_270_degrees_in_three_quarters_of_its_period():
    p = utm30lx()
    assert (p.rings, p.columns, p.period) == (1, 1081, 0.025)
    np.testing.assert_allclose(np.degrees(p.azimuths[[0, 540, -1]]), [-135, 0, 135], atol=1e-9)
    assert p.times[-1] == pytest.approx(0.75 * 0.025)
    assert (p.min_range, p.max_range) == (0.1, 30.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"elevations": np.zeros(0)}, "number of rings"),
        ({"elevations": np.zeros(257)}, "number of rings"),
        ({"azimuths": np.zeros(65537)}, "number of columns"),
        ({"times": np.zeros(3)}, "lengths differ"),
        ({"heights": np.zeros(2)}, "lengths differ"),
        ({"times": np.array([0, 0.2, 0.1, 0.3])}, "times are not rising"),
        ({"period": 0.3}, "times are not rising"),
        ({"min_range": 50.0}, "0 <= min_range < max_range"),
        ({"min_range": -1.0}, "0 <= min_range < max_range"),
        ({"range_noise": -0.01}, "range_noise >= 0"),
        ({"detection_range": 0.0}, "detection_range > 0"),
    ],
)
def test_pattern_that_does_not_fit_together_is_refused(changes, message):
    with pytest.raises(ConfigError, match=message):
        pattern(**changes)


# --- a real sensor --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def rotations():
    """Four rotations of a VLP-16 that stood still in a room."""
    files = sorted(ROTATIONS.glob("vlp16_scan_*.npz"))
    if not files:
        pytest.skip(f"no recorded VLP-16 rotations in {ROTATIONS}")
    return [dict(np.load(file)) for file in files]


def test_real_vlp16_beams_have_the_elevation_and_height_of_their_ring(rotations):
    p = vlp16()
    for scan in rotations:
        x, y, z = scan["xyz"].astype(float).T
        elevation = np.arctan2(z - p.heights[scan["ring"]], np.hypot(x, y))
        assert np.degrees(np.abs(elevation - p.elevations[scan["ring"]])).max() < 0.02
        # Without the heights the error would be that of a beam 11 mm off at half a metre.
        assert np.degrees(np.abs(np.arctan2(z, np.hypot(x, y)) - p.elevations[scan["ring"]])).max() > 0.5


def test_real_vlp16_turns_clockwise_by_a_column_of_the_model_per_firing(rotations):
    p = vlp16()
    steps, intervals = [], []
    for scan in rotations:
        for ring in range(1, 16):
            mine = scan["ring"] == ring
            order = np.argsort(scan["t"][mine])
            azimuth = np.arctan2(scan["xyz"][mine, 1], scan["xyz"][mine, 0])[order].astype(float)
            steps.append(np.diff(azimuth))
            intervals.append(np.diff(scan["t"][mine][order].astype(float)))
    step, interval = np.concatenate(steps), np.concatenate(intervals)
    successive = interval < 8e-5
    assert np.median(step[successive]) == pytest.approx(p.azimuths[1] - p.azimuths[0], rel=0.01)
    assert np.median(interval[successive]) == pytest.approx(p.times[1] - p.times[0], rel=0.01)


def smooth_patches(rotations, shots):
    """Of every run of `shots` successive shots of a ring that lie on one smooth surface: their distances about a cubic
    in azimuth, and their intensities as shares of 255."""
    for scan in rotations:
        azimuth = np.arctan2(scan["xyz"][:, 1], scan["xyz"][:, 0]).astype(float)
        distance = np.linalg.norm(scan["xyz"].astype(float), axis=1)
        for ring in range(1, 16):
            mine = np.flatnonzero(scan["ring"] == ring)
            mine = mine[np.argsort(azimuth[mine])]
            for window in np.array_split(mine, max(1, len(mine) // shots)):
                angle = azimuth[window] - azimuth[window].mean()
                if len(window) < 0.8 * shots or np.ptp(angle) > np.radians(0.28 * shots):
                    continue
                residual = distance[window] - np.polynomial.Polynomial.fit(angle, distance[window], 3)(angle)
                if np.abs(residual).max() < 0.05:
                    yield residual, scan["intensity"][window] / 255


def test_real_vlp16_noise_on_smooth_patches_is_that_of_the_model(rotations):
    patches = list(smooth_patches(rotations, 25))
    assert len(patches) > 500
    deviations = [np.sqrt(np.sum(residual**2) / (len(residual) - 4)) for residual, _ in patches]
    assert np.median(deviations) == pytest.approx(vlp16().range_noise, rel=0.15)


def test_real_vlp16_intensity_varies_as_much_as_in_the_model(rotations):
    differences = [np.std(np.diff(intensity)) / np.sqrt(2) for _, intensity in smooth_patches(rotations, 12)]
    assert len(differences) > 1000
    assert np.median(differences) == pytest.approx(LidarConfig().intensity_noise, rel=0.3)


def test_real_vlp16_ranges_and_intensities_are_within_those_of_the_model(rotations):
    p = vlp16()
    for scan in rotations:
        distance = np.linalg.norm(scan["xyz"], axis=1)
        assert p.min_range < distance.min()
        assert distance.max() < p.max_range
        # Diffuse reflectivity is coded as 0 to 100, retro-reflectors above; a share of 255 is our intensity.
        intensity = scan["intensity"] / 255
        assert intensity.min() >= 0
        assert intensity.max() <= 1
        assert 0 < np.median(intensity) < 0.5
