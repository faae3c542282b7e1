"""Hot things: against what ambient, with what edge, and grouped in space."""

import numpy as np
import open3d as o3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.hazards.heat import HeatConfig, HeatDetector, ambient_temperature, heat_probability, hot_regions
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue


def room_with_pipe(seed=0, pipe=80.0, ambient=20.0, noise=1.0):
    """A floor, and a horizontal pipe of radius 0.12 m at 1 m; its ends fade into their surroundings."""
    rng = np.random.default_rng(seed)
    floor = np.column_stack([rng.uniform(-4, 4, (20_000, 2)), np.zeros(20_000)])
    x, angle = rng.uniform(-2, 2, 3000), rng.uniform(0, 2 * np.pi, 3000)
    tube = np.column_stack([x, 0.12 * np.cos(angle), 1 + 0.12 * np.sin(angle)])
    points = np.vstack([floor, tube])
    share = np.r_[np.zeros(20_000), np.clip((1.5 - np.abs(x)) / 0.2 + 0.5, 0, 1)]  # the heat ends at |x| = 1.5
    temperature = ambient + share * (pipe - ambient) + rng.normal(0, noise, len(points))
    return points, temperature, np.r_[np.zeros(20_000, bool), np.abs(x) < 1.5]


def hot(points, temperature, **options):
    config = HeatConfig(**options)
    probability = heat_probability(points, temperature, config)
    return probability, hot_regions(points, temperature, probability, config)


@pytest.mark.parametrize("ambient", [-10.0, 20.0, 45.0])
def test_the_pipe_is_found_whatever_the_ambient(ambient):
    points, temperature, truth = room_with_pipe(ambient=ambient, pipe=ambient + 60)
    probability, spots = hot(points, temperature)
    found = probability > 0.5
    assert np.sum(found & truth) / np.sum(found | truth) > 0.9
    (spot,) = spots
    assert spot.label == "heat"
    np.testing.assert_allclose(spot.p_MC, [0, 0, 1], atol=0.05)
    assert spot.max_temperature == temperature[found].max()
    assert spot.mean_temperature == pytest.approx(ambient + 60, abs=3)
    np.testing.assert_allclose(spot.high_M - spot.low_M, [3, 0.24, 0.24], atol=0.1)
    assert 3 * 0.24 < spot.area < 3.2 * 0.44  # whole cells: nothing is beside it that says where they end


def test_a_room_without_anything_hot_has_no_hot_spot_even_when_it_is_noisy():
    points, temperature, _ = room_with_pipe(pipe=20.0, noise=8.0)
    probability, spots = hot(points, temperature)
    assert spots == ()
    assert np.mean(probability > 0.5) < 1e-3


def test_hot_things_one_above_the_other_are_two():
    points, temperature, _ = room_with_pipe()
    below = points[20_000:] - np.array([0, 0, 0.7])
    everything, values = np.vstack([points, below]), np.r_[temperature, temperature[20_000:] + 50]
    _, spots = hot(everything, values)
    assert [round(spot.p_MC[2], 1) for spot in spots] == [0.3, 1.0]  # the hottest first


def test_a_warm_thing_beside_a_hotter_one_stays_hot():
    points, temperature, _ = room_with_pipe(noise=0.1)
    x = points[:, 0]
    temperature = np.where((points[:, 2] > 0.5) & (np.abs(x) < 1.5), np.where(x > 0, 200.0, 60.0), temperature)
    probability, _ = hot(points, temperature)
    assert (probability[(points[:, 2] > 0.5) & (x < -0.3) & (x > -1.4)] > 0.5).all()


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 100), shift=st.floats(-50, 50))
def test_only_the_excess_counts_and_more_of_it_is_never_less_likely(seed, shift):
    rng = np.random.default_rng(seed)
    points, temperature = rng.uniform(0, 30, (200, 3)), rng.normal(20, 2, 200)
    temperature[:9] = rng.uniform(20, 100, 9)
    probability = heat_probability(points, temperature)
    np.testing.assert_allclose(heat_probability(points, temperature + shift), probability, atol=1e-6)
    order = np.argsort(temperature)
    apart = heat_probability(points, temperature, HeatConfig(blur=0.0))
    assert (np.diff(apart[order]) >= 0).all()


def test_what_was_never_seen_stays_unknown():
    points, temperature, truth = room_with_pipe()
    temperature[::2] = np.nan
    probability, spots = hot(points, temperature)
    assert np.isnan(probability[::2]).all()
    assert np.isfinite(probability[1::2]).all()
    assert len(spots) == 1
    assert spots[0].points < truth.sum()


@pytest.mark.parametrize("count", [0, 1, 5])
def test_clouds_with_nothing_in_them_have_no_heat(count):
    points, nothing = np.zeros((count, 3)), np.full(count, np.nan)
    probability, spots = hot(points, nothing)
    assert np.isnan(probability).all()
    assert spots == ()
    assert hot(np.full((count, 3), np.nan), np.full(count, 20.0))[1] == ()
    assert hot(points, np.full(count, 20.0))[1] == ()
    assert np.isnan(ambient_temperature(nothing)).all()


def cloud_of(points, temperature=None):
    cloud = PointCloud(o3d.core.Tensor(np.asarray(points, np.float32)))
    if temperature is not None:
        cloud.point["temperature"] = o3d.core.Tensor(np.asarray(temperature, np.float32)[:, None])
    return cloud


def detected(value):
    system = HeatDetector()
    context = system.CreateDefaultContext()
    system.GetInputPort("map_M").FixValue(context, AbstractValue.Make(value))
    return [system.GetOutputPort(name).Eval(context) for name in ("heat_probability", "hot_spots")]


def test_the_system_gives_what_the_functions_give():
    points, temperature, _ = room_with_pipe()
    probability, spots = detected(cloud_of(points, temperature))
    expected = heat_probability(np.float32(points), np.float32(temperature))
    np.testing.assert_allclose(probability, expected)
    assert len(spots) == 1
    assert spots[0].points == np.sum(expected > 0.5)


def test_the_system_bears_maps_without_temperature_and_refuses_what_is_no_map():
    for cloud in (cloud_of(np.zeros((3, 3))), cloud_of(np.zeros((0, 3))), PointCloud()):
        probability, spots = detected(cloud)
        assert np.isnan(probability).all()
        assert spots == ()
    with pytest.raises(PortError, match="map_M"):
        detected({"not": "a cloud"})
    with pytest.raises(ConfigError, match="min_excess"):
        HeatDetector(HeatConfig(min_excess=-1))
