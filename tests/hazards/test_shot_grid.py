"""What shots say about water, and how the grid keeps them."""

import copy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from naraha.systems.hazards.shot_grid import MISSING, ShotConfig, ShotGrid, Shots, shot_evidence

CONFIG = ShotConfig()


@given(distance=st.floats(0.3, 30.0), height=st.floats(0.05, 2.0))
def test_a_return_never_speaks_for_water_and_a_missing_one_never_against(distance, height):
    hit, missing, weight = shot_evidence(np.array([distance]), np.array([height]), 150.0, CONFIG)[:, 0]
    assert hit <= 0 <= missing
    assert 0 <= weight <= 1
    assert np.isfinite([hit, missing]).all()


def test_shots_from_too_near_and_from_too_far_say_little():
    _, _, weight = shot_evidence(np.array([0.8, 3.0, 30.0]), np.full(3, 0.3), 150.0, CONFIG)
    assert weight[0] < 0.05
    assert weight[1] > 0.9
    assert weight[2] < 0.05


def test_a_shot_in_the_middle_of_the_range_is_a_bernoulli_trial_with_the_stated_chances():
    hit, missing, _ = shot_evidence(np.array([3.2]), np.array([0.3]), 150.0, CONFIG)[:, 0]
    assert hit == pytest.approx(np.log(0.1 / 0.98), abs=0.02)
    assert missing == pytest.approx(np.log(0.9 / 0.02), abs=0.1)


def uniform_shots(xy, evidence, weight=1.0, kind=MISSING):
    count = len(xy)
    return Shots(
        np.asarray(xy, float), np.full(count, kind, np.uint8), np.full(count, evidence), np.full(count, weight)
    )


def test_many_shots_at_one_place_count_as_a_few():
    one = ShotGrid(CONFIG).add(uniform_shots([[0.05, 0.05]], 1.0))
    many = ShotGrid(CONFIG).add(uniform_shots([[0.05, 0.05]] * 1000, 1.0))
    assert one.log_likelihood_ratio([[0.05, 0.05]])[0] == pytest.approx(4 / 5 * 1 / 3)
    assert many.log_likelihood_ratio([[0.05, 0.05]])[0] == pytest.approx(CONFIG.worth, rel=0.01)
    sure = many.add(uniform_shots([[0.05, 0.05]] * 1000, 9.0))
    assert sure.log_likelihood_ratio([[0.05, 0.05]])[0] == CONFIG.limit


def test_a_cell_with_few_shots_takes_in_its_neighbours_and_one_without_says_nothing():
    ground = [[x, y] for x in (0.05, 0.15, 0.25) for y in (0.05, 0.15, 0.25) if (x, y) != (0.15, 0.15)]
    grid = ShotGrid(CONFIG).add(uniform_shots(np.repeat(ground, 100, axis=0), -1.0))
    assert grid.log_likelihood_ratio([[0.15, 0.15]])[0] == 0
    alone = ShotGrid(CONFIG).add(uniform_shots([[0.15, 0.15]], 1.0)).log_likelihood_ratio([[0.15, 0.15]])[0]
    among = grid.add(uniform_shots([[0.15, 0.15]], 1.0)).log_likelihood_ratio([[0.15, 0.15]])[0]
    assert alone > 0 > among > grid.log_likelihood_ratio([ground[0]])[0]


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 1000), parts=st.integers(1, 5), spread=st.sampled_from([0.3, 5.0, 15.0]))
def test_the_grid_is_the_same_however_the_shots_arrive(seed, parts, spread):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-spread, spread, (300, 2))
    kind, evidence = rng.integers(0, 4, 300).astype(np.uint8), rng.normal(0, 2, 300)
    whole = ShotGrid(CONFIG).add(Shots(xy, kind, evidence, np.ones(300)))
    grown = ShotGrid(CONFIG)
    for part in np.array_split(rng.permutation(300), parts):
        grown = grown.add(Shots(xy[part], kind[part], evidence[part], np.ones(len(part))))
    np.testing.assert_array_equal(grown.counts(xy), whole.counts(xy))
    np.testing.assert_allclose(grown.log_likelihood_ratio(xy), whole.log_likelihood_ratio(xy), atol=1e-4)
    cells = np.unique(np.floor(xy / CONFIG.cell), axis=0)
    assert whole.counts((cells + 0.5) * CONFIG.cell).sum() == 300


def test_adding_leaves_the_grid_before_it_as_it_was_and_shares_what_did_not_change():
    before = ShotGrid(CONFIG).add(uniform_shots([[0.05, 0.05], [50.05, 0.05]], 1.0))
    after = before.add(uniform_shots([[0.05, 0.05]], 1.0))
    assert before.counts([[0.05, 0.05]])[0, MISSING] == 1
    assert after.counts([[0.05, 0.05]])[0, MISSING] == 2
    assert sum(after.tiles[key] is before.tiles[key] for key in before.tiles) == 1
    assert copy.deepcopy(after) is after


def test_the_empty_grid_knows_nothing():
    assert ShotGrid().log_likelihood_ratio(np.zeros((3, 2))).tolist() == [0, 0, 0]
    assert ShotGrid().counts(np.zeros((0, 2))).shape == (0, 4)
