"""Dark against bright: thresholds from the data, in made-up and in recorded brightness."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from naraha.systems.hazards.brightness import dark_threshold
from naraha.systems.hazards.lidar_water import floor_height
from naraha.systems.hazards.water import WaterConfig, water_probability


def floor_and_water(count, seed=0):
    rng = np.random.default_rng(seed)
    return np.r_[rng.normal(0.35, 0.06, 9000), np.abs(rng.normal(0.02, 0.015, count))]


@pytest.mark.parametrize("count", [60, 300, 3000, 9000, 30_000])
def test_the_threshold_lies_in_the_valley_however_unequal_the_populations(count):
    values = floor_and_water(count)
    threshold = dark_threshold(values)
    assert threshold.valley
    assert (values[:9000] > threshold.value).mean() > 0.99
    assert (values[9000:] < threshold.value).mean() > 0.97


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), width=st.floats(0.02, 0.8), count=st.integers(40, 5000))
def test_one_population_has_no_valley_whatever_its_width(seed, width, count):
    values = np.random.default_rng(seed).lognormal(-1, width, count)
    threshold = dark_threshold(values)
    assert not threshold.valley
    assert threshold.value == pytest.approx(0.4 * np.median(values))


@given(scale=st.floats(1e-3, 1e5))
def test_the_scale_of_the_brightness_does_not_matter(scale):
    values = floor_and_water(500)
    assert dark_threshold(scale * values).value == pytest.approx(scale * dark_threshold(values).value, rel=1e-3)


def test_the_steps_of_whole_numbers_are_no_valleys():
    steps = np.random.default_rng(1).poisson(5, 20_000) + 1
    assert not dark_threshold(steps).valley


def test_a_few_glaring_spots_do_not_make_the_rest_dark():
    values = np.r_[np.random.default_rng(2).normal(0.35, 0.05, 9000), np.full(200, 5.0)]
    assert dark_threshold(values).value < 0.2


@pytest.mark.parametrize("values", [[], [np.nan] * 9, [0.0] * 9, [np.inf, np.nan], [0.3], [0.3] * 1000])
def test_too_little_to_choose_from_gives_no_valley(values):
    threshold = dark_threshold(np.array(values))
    assert not threshold.valley
    known = [v for v in values if np.isfinite(v) and v > 0]
    assert threshold.value == pytest.approx(0.12) if known else not threshold.value > 0


@pytest.fixture(params=["lb_n3_0", "lb_n3_1", "os0_128_u1", "single_scan_016"])
def street(request):
    """A recorded scan of a street with passive near-infrared brightness and calibrated reflectivity."""
    path = Path(__file__).parents[2].parent / "shared" / "data" / "ouster_sdk" / f"{request.param}.npz"
    if not path.is_file():
        pytest.skip(f"the recorded scan is not there: {path}")
    with np.load(path) as data:
        return (
            request.param,
            data["xyz"].astype(float),
            data["near_ir"].astype(float),
            data["reflectivity"].astype(float),
        )


def test_a_recorded_street_is_not_called_water(street):
    _, points, near_ir, _ = street
    away = np.linalg.norm(points, axis=1)
    z_floor = floor_height(points[away < 15])
    nir = near_ir / np.percentile(near_ir, 99)
    config = WaterConfig(threshold=None, threshold_limit=1.0)
    probability = water_probability(points, nir=nir, nir_range=away, z_floor=z_floor, config=config)
    on_street = (away < 15) & (np.abs(points[:, 2] - z_floor) < 0.1)
    assert on_street.sum() > 5000
    assert np.mean(probability[on_street] > 0.5) < 0.002
    black = nir.copy()
    place = points[on_street][np.argmin(away[on_street])]
    puddle = on_street & (np.hypot(*(points[:, :2] - place[:2]).T) < 0.5)
    assert puddle.sum() > 50
    black[puddle] = 0.01 * np.median(nir[on_street])  # as water at 1450 nm; at the sensor's 865 nm it is not dark
    probability = water_probability(points, nir=black, nir_range=away, z_floor=z_floor, config=config)
    assert np.mean(probability[puddle] > 0.5) > 0.9
    assert np.mean(probability[on_street & ~puddle] > 0.5) < 0.005


def test_recorded_reflectivity_splits_where_its_histogram_has_a_valley(street):
    name, _, _, reflectivity = street
    threshold = dark_threshold(reflectivity)
    # Values up to 1 pile up there. Only in this scan there are few between them and the asphalt: 14 607 ones, 3 700 of
    # each of 2 to 4, 6 900 sixes.
    assert threshold.valley == (name == "single_scan_016")
    assert 1 < threshold.value < 0.5 * np.median(reflectivity)
