"""Fuzzy inference against closed forms, an independent implementation, and what a robot may expect of it."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.errors import ConfigError
from naraha.systems.traversability import FuzzyConfig, GradeTerms, Mamdani, SizeTerms, default_rules
from naraha.systems.traversability.mamdani import GRADES, INPUTS, SIZES, trapezoid

DEFAULT = Mamdani(FuzzyConfig())
values = st.floats(0, 0.6)


def by_hand(x, config):
    """Min-max-centroid, written out with arrays over the universe."""
    grades = config.traversability.table()
    universe = np.linspace(grades.min(), grades.max(), config.samples)
    shape = np.zeros_like(universe)
    for *sizes, grade in config.rules:
        met = 1.0
        for name, size, value in zip(INPUTS, sizes, x, strict=True):
            corners = getattr(config, name).table()[SIZES.index(size)].copy()
            if size == "LARGE" and value > corners[3]:
                value = corners[3]
            met = min(met, float(trapezoid(np.array([value]), corners)[0]))
        shape = np.maximum(shape, np.minimum(met, trapezoid(universe, grades[GRADES.index(grade)])))
    return np.trapezoid(universe * shape, universe) / np.trapezoid(shape, universe)


@given(st.lists(st.tuples(values, values, values), min_size=1, max_size=20))
def test_inference_is_min_max_centroid(features):
    tau = DEFAULT.infer(np.array(features)).traversability
    np.testing.assert_allclose(tau, [by_hand(x, DEFAULT.config) for x in features], rtol=1e-9)


def test_one_grade_alone_gives_the_centroid_of_its_term():
    """A ramp from a to b has its centroid at a + 2/3 (b − a), a triangle at the mean of its corners."""
    fine = Mamdani(FuzzyConfig(samples=10001))
    tau = fine.infer(np.array([[0, 0, 0], [0.25, 0, 0], [0.25, 0.25, 0], [1, 1, 1]])).traversability
    top = 0.06618
    np.testing.assert_allclose(tau, [top * 8 / 9, top * 2 / 3, top / 3, top / 9], rtol=2e-3)
    assert 1 / tau[0] == pytest.approx(17, abs=0.1)


@given(st.tuples(values, values, values), st.integers(0, 2), st.floats(0, 0.3))
def test_worse_ground_is_hardly_ever_easier(features, which, more):
    """A clipped term has another centroid than a whole one: min-max-centroid is not quite monotone, up to a fifth."""
    worse = np.array(features)
    worse[which] += more
    tau = DEFAULT.infer(np.array([features, worse])).traversability
    assert tau[1] <= tau[0] * 1.21


def test_a_robot_that_can_do_more_finds_the_same_ground_easier():
    able = SizeTerms(small=[0, 0, 0.3, 0.4], medium=[0.3, 0.4, 0.5, 0.6], large=[0.5, 0.6, 0.6, 0.6])
    x = np.array([[0.395, 0.1, 0.0]])
    weak, strong = DEFAULT.infer(x), Mamdani(replace(FuzzyConfig(), pitch_slope=able)).infer(x)
    assert weak.risk[0] > 60 > strong.risk[0]
    assert weak.activations[0, 0] == pytest.approx(0.95)


def test_what_is_not_known_is_as_bad_as_can_be():
    tau = DEFAULT.infer(np.array([[np.nan, 0, 0], [0, np.inf, 0], [1, 1, 1]])).traversability
    np.testing.assert_allclose(tau, DEFAULT.lowest)
    assert DEFAULT.infer(np.zeros((0, 3))).traversability.shape == (0,)


def test_any_large_is_poor_and_all_small_is_high():
    rules = {tuple(sizes): grade for *sizes, grade in default_rules()}
    assert set(rules) == set(product(SIZES, repeat=3))
    assert rules["SMALL", "SMALL", "SMALL"] == "HIGH"
    assert all((grade == "POOR") == ("LARGE" in sizes) for sizes, grade in rules.items())


def test_a_hole_in_the_table_of_rules_is_named():
    rules = default_rules()
    del rules[5]
    with pytest.raises(ConfigError, match=r"rules: a rule is missing .*'SMALL', 'MEDIUM', 'LARGE'"):
        Mamdani(FuzzyConfig(rules=rules))


@pytest.mark.parametrize(
    ("config", "words"),
    [
        (FuzzyConfig(rules=[*default_rules(), ["SMALL", "SMALL", "SMALL", "LOW"]]), "rules.27.: there is a rule"),
        (FuzzyConfig(rules=[["SMALL", "SMALL", "HIGH"]]), "not a rule"),
        (FuzzyConfig(rules=[["SMALL", "SMALL", "TINY", "HIGH"]]), "not a rule"),
        (FuzzyConfig(pitch_slope=SizeTerms(small=[0, 0.3, 0.1, 0.2])), "pitch_slope.small: not a trapezoid"),
        (FuzzyConfig(roughness=SizeTerms(medium=[0.25, 0.3, 0.3, 0.4])), "roughness.medium: a gap between terms"),
        (FuzzyConfig(traversability=GradeTerms(low=[0, 0.1])), "traversability.low: not a trapezoid"),
    ],
)
def test_terms_and_rules_that_cannot_be_used_are_named(config, words):
    with pytest.raises(ConfigError, match=words):
        Mamdani(config)
