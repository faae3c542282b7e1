"""Probability of water: what each filter does, what is unknown, and what all of them reach together."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from naraha.systems.errors import InputError
from naraha.systems.hazards.shot_grid import MISSING, ShotConfig, ShotGrid, Shots
from naraha.systems.hazards.water import FILTERS, WaterConfig, find_puddles, water_probability

WATER, FLOOR = 0.02, 0.35


def grid_that_says(evidence, low=0.0, high=1.0):
    """A grid with this log likelihood ratio between low and high in x and y."""
    x = np.arange(low + 0.05, high, 0.1)
    xy = np.repeat(np.stack(np.meshgrid(x, x), -1).reshape(-1, 2), 1000, axis=0)
    share = np.full(len(xy), evidence / 4.0 * 1.004)
    return ShotGrid(ShotConfig()).add(Shots(xy, np.full(len(xy), MISSING, np.uint8), share, np.ones(len(xy))))


def one(nir=np.nan, *, z=0.0, nir_range=2.0, tilt=0.0, shots=None, filters=FILTERS, **config):
    return water_probability(
        np.array([[0.45, 0.45, z]]),
        nir=np.array([nir]),
        nir_range=np.array([nir_range]),
        tilt=np.array([tilt]),
        shots=shots,
        z_floor=0.0,
        filters=filters,
        config=WaterConfig(**config),
    )[0]


def test_dark_at_the_floor_is_water_and_bright_is_not():
    assert one(WATER) > 0.6
    assert one(FLOOR) < 0.01


def test_the_threshold_alone_calls_everything_dark_water():
    for trap in (one(0.04, z=0.8, filters=["threshold"]), one(0.04, nir_range=30, filters=["threshold"])):
        assert trap > 0.6


@given(near=st.floats(0, 50), farther=st.floats(0, 50), nir=st.floats(0, 1))
def test_trust_in_the_dark_falls_with_range(near, farther, nir):
    close, far = one(nir, nir_range=near), one(nir, nir_range=near + farther)
    assert far <= close + 1e-12


def test_dark_from_far_away_is_not_water_but_bright_is_dry_from_anywhere():
    assert one(WATER, nir_range=5) > 0.5
    assert one(WATER, nir_range=12) < 0.5
    assert one(FLOOR, nir_range=12) == pytest.approx(one(FLOOR, nir_range=1))
    assert one(WATER, nir_range=np.nan) == pytest.approx(one(WATER, nir_range=0.0))


@given(tilt=st.floats(0, np.pi / 2), z=st.floats(-2, 2))
def test_what_is_steep_or_away_from_the_floor_is_no_water(tilt, z):
    probability = one(WATER, tilt=tilt, z=z)
    if tilt > np.radians(40) or abs(z) > 0.15:
        assert probability < 0.01
    elif tilt < np.radians(20) and abs(z) < 0.07:
        assert probability == pytest.approx(one(WATER))
    assert one(WATER, tilt=np.pi - tilt, z=z) == pytest.approx(probability)


def test_an_unknown_tilt_is_that_of_the_neighbours_or_else_height_decides():
    assert one(WATER, tilt=np.nan) == pytest.approx(one(WATER))
    assert one(WATER, tilt=np.nan, z=0.5) < 0.01
    points = np.column_stack([np.linspace(0, 0.2, 9), np.zeros(9), np.linspace(0, 0.06, 9)])
    tilt = np.full(9, 1.4)
    tilt[4] = np.nan
    assert water_probability(points, nir=np.full(9, WATER), tilt=tilt, z_floor=0.0).max() < 0.01
    tilt[:] = 0.05
    tilt[4] = np.nan
    assert water_probability(points, nir=np.full(9, WATER), tilt=tilt, z_floor=0.0).min() > 0.6


def test_lidar_evidence_decides_about_dark_floors():
    assert one(0.05, shots=grid_that_says(-4)) < 0.1
    assert one(WATER, shots=grid_that_says(4)) > 0.98
    assert one(WATER, shots=grid_that_says(4), filters=["threshold"]) == one(WATER, filters=["threshold"])


def test_a_bright_floor_stays_dry_against_missing_shots():
    assert one(FLOOR, shots=grid_that_says(6)) < 0.5


def test_lidar_alone_declares_water_only_where_it_is_sure():
    assert one(shots=grid_that_says(3)) < 0.5
    assert one(shots=grid_that_says(5.5)) > 0.5
    assert one(shots=grid_that_says(-5)) < 0.02
    assert one(shots=grid_that_says(5.5), z=0.5) != one(shots=grid_that_says(5.5))


def test_what_nobody_has_looked_at_is_unknown():
    assert np.isnan(one())
    assert np.isnan(one(shots=ShotGrid()))
    assert np.isnan(one(shots=grid_that_says(5, 3, 4)))
    assert np.isnan(one(shots=grid_that_says(5), filters=["threshold", "tilt"]))
    assert np.isnan(one(shots=grid_that_says(5), z=1.0))
    assert np.isnan(one(WATER, filters=["tilt"]))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), filters=st.sets(st.sampled_from(FILTERS)))
def test_every_probability_is_in_range_or_unknown(seed, filters):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (50, 3))
    values = rng.uniform(-0.1, 1, (3, 50))
    values[rng.random((3, 50)) < 0.3] = np.nan
    points[rng.random(50) < 0.1] = np.nan
    shots = grid_that_says(rng.uniform(-6, 6))
    found = water_probability(
        points, nir=values[0], nir_range=10 * values[1], tilt=values[2], shots=shots, filters=filters
    )
    assert found.shape == (50,)
    known = ~np.isnan(found)
    assert ((found[known] >= 0) & (found[known] <= 1)).all()
    assert not known[np.isnan(points).any(axis=1)].any()


@pytest.mark.parametrize("share", [0.0, 0.01, 0.2, 0.8])
def test_a_threshold_from_the_data_finds_the_water_if_there_is_any(share):
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(0, 5, (8000, 2)), np.zeros(8000)])
    water = rng.random(8000) < share
    nir = np.where(water, np.abs(rng.normal(0.03, 0.01, 8000)), rng.normal(0.3, 0.05, 8000))
    config = WaterConfig(threshold=None)
    found = water_probability(points, nir=nir, z_floor=0.0, config=config) > 0.5
    assert np.mean(found != water) < 0.005
    paints = np.where(water, rng.normal(0.3, 0.02, 8000), rng.normal(0.8, 0.05, 8000))
    assert not (water_probability(points, nir=paints, z_floor=0.0, config=config) > 0.5).any()


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.zeros((1, 3)), np.full((4, 3), np.nan)])
def test_clouds_with_nothing_in_them_have_no_water(points):
    nothing = np.full(len(points), np.nan)
    for nir in (None, nothing):
        found = water_probability(points, nir=nir, tilt=nothing, shots=ShotGrid())
        assert found.shape == (len(points),)
        assert np.isnan(found).all()
        assert find_puddles(points, found) == ()
    assert water_probability(points, nir=np.zeros(len(points))).shape == (len(points),)


def test_wrong_arguments_are_refused_with_the_valid_ones():
    with pytest.raises(InputError, match="threshold, range, tilt, lidar"):
        one(WATER, filters=["imu"])
    with pytest.raises(InputError, match="nir: length"):
        water_probability(np.zeros((3, 3)), nir=np.zeros(2))


def test_puddles_are_groups_of_water_in_plan():
    rng = np.random.default_rng(4)
    points = np.column_stack([rng.uniform(0, 4, (30_000, 2)), rng.normal(0, 0.01, 30_000)])
    water = np.hypot(points[:, 0] - 1, points[:, 1] - 1) < 0.4
    water |= np.hypot(points[:, 0] - 3, points[:, 1] - 3) < 0.3
    large, small = find_puddles(points, np.where(water, 0.9, np.where(points[:, 0] < 2, 0.1, np.nan)))
    np.testing.assert_allclose(large.p_MC[:2], 1, atol=0.02)
    np.testing.assert_allclose(small.p_MC[:2], 3, atol=0.02)
    assert large.label == "water"
    assert large.area == pytest.approx(np.pi * 0.16, rel=0.06)


def patches(*kinds):
    """A floor of 0.1 m voxels around patches of 0.5 m, 2 m apart along x: points, nir, and the shots on them.

    A patch is dark, wet for the LiDAR, both, or "seen by LiDAR alone".
    """
    axes = np.arange(-0.95, 2.0 * len(kinds), 0.1), np.arange(-0.95, 1.0, 0.1)
    p_MP = np.column_stack([np.stack(np.meshgrid(*axes), -1).reshape(-1, 2), np.zeros(len(axes[0]) * len(axes[1]))])
    nir, xy, evidence = np.full(len(p_MP), 0.35), [], []
    for i, kind in enumerate(kinds):
        inside = np.hypot(p_MP[:, 0] - 2.0 * i, p_MP[:, 1]) < 0.3
        if kind != "wet":
            nir[inside] = 0.01
        if kind == "unseen":
            nir[inside] = np.nan
        if kind != "dark":
            xy.append(np.repeat(p_MP[inside, :2], 20, axis=0))
            evidence.append(np.full(len(xy[-1]), 3.0))
    xy, evidence = np.vstack(xy), np.concatenate(evidence)
    shots = ShotGrid(ShotConfig()).add(Shots(xy, np.full(len(xy), MISSING, np.uint8), evidence, np.ones(len(xy))))
    return p_MP, nir, shots


def test_a_patch_is_water_only_where_near_infrared_and_lidar_agree():
    """A shadow is dark and no LiDAR shot speaks for water; a patch of missing shots is nothing that a camera saw."""
    p_MP, nir, shots = patches("both", "dark", "unseen")
    level = np.zeros(len(p_MP))
    probability = water_probability(p_MP, nir=nir, nir_range=level + 2, tilt=level, shots=shots)
    (puddle,) = find_puddles(p_MP, probability)
    np.testing.assert_allclose(puddle.p_MC[:2], 0, atol=0.02)
    without = water_probability(
        p_MP, nir=nir, nir_range=level + 2, tilt=level, shots=shots, config=WaterConfig(agreement=0)
    )
    assert len(find_puddles(p_MP, without)) == 3


def test_missing_shots_beside_a_puddle_are_no_puddle_of_their_own():
    """Under a stair, say, 0.4 m from a puddle: too far to be its rest, near enough to pass for a part of its patch."""
    p_MP, nir, shots = patches("both")
    beside = (np.abs(p_MP[:, 0] - 0.8) < 0.11) & (np.abs(p_MP[:, 1]) < 0.11)
    nir[beside] = np.nan
    xy = np.repeat(p_MP[beside, :2], 20, axis=0)
    shots = shots.add(Shots(xy, np.full(len(xy), MISSING, np.uint8), np.full(len(xy), 3.0), np.ones(len(xy))))
    level = np.zeros(len(p_MP))
    probability = water_probability(p_MP, nir=nir, nir_range=level + 2, tilt=level, shots=shots)
    assert (probability[beside] < 0.5).all()
    assert (probability[beside] > 0.3).all()
    assert len(find_puddles(p_MP, probability)) == 1


def test_without_any_near_infrared_lidar_may_speak_for_itself():
    p_MP, _, shots = patches("both")
    probability = water_probability(p_MP, tilt=np.zeros(len(p_MP)), shots=shots)
    assert len(find_puddles(p_MP, probability)) == 1
