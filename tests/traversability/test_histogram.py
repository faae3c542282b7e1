from dataclasses import replace

import numpy as np
import pytest
from naraha.systems.errors import PortError
from naraha.systems.traversability import (
    IMPASSABLE,
    REASONS,
    PolarRiskHistogram,
    TerrainConfig,
    describe_terrain,
    make_histogram,
)
from pydrake.common.value import AbstractValue

from tests.traversability.unicycle_world import pioneer, scan


def flat_features():
    return describe_terrain(scan([], np.zeros(3)), TerrainConfig())


def changed(k, **values):
    """Features of flat ground, with other values in rectangle `k`."""
    features = flat_features()
    for name, value in values.items():
        array = getattr(features, name).copy()
        array[k] = value
        features = replace(features, **{name: array})
    return features


def test_risk_is_the_inverse_of_traversability():
    tau = np.linspace(0.03, 0.06, 9)
    histogram = make_histogram(flat_features(), tau, pioneer())
    np.testing.assert_allclose(histogram.risk, 1 / tau)
    assert histogram.passable.all()


def test_risk_at_the_limit_is_too_risky_and_below_it_is_not():
    limit = pioneer().risk_limit
    tau = np.full(9, 0.06)
    tau[3], tau[5] = 1 / limit, 1 / (limit - 0.01)
    histogram = make_histogram(flat_features(), tau, pioneer())
    assert REASONS[histogram.reason[3]] == "too risky"
    assert list(np.flatnonzero(~histogram.passable)) == [3]


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"mean_height": 0.9}, "too high"),
        ({"step_height": 0.05}, "step"),
        ({"coverage": 0.4}, "unseen"),
        ({"mean_height": np.nan}, "unseen"),
        ({"mean_height": 0.9, "step_height": 0.05, "coverage": 0.1}, "unseen"),
        ({"mean_height": 0.9, "step_height": 0.05}, "too high"),
    ],
)
def test_a_threshold_rules_a_rectangle_out_and_says_which(values, reason):
    histogram = make_histogram(changed(4, **values), np.full(9, 0.06), pioneer())
    assert REASONS[histogram.reason[4]] == reason
    assert histogram.risk[4] == IMPASSABLE
    assert list(np.flatnonzero(~histogram.passable)) == [4]


@pytest.mark.parametrize("tau", [0.0, -1.0, np.nan])
def test_traversability_that_is_none_is_impassable(tau):
    histogram = make_histogram(flat_features(), np.full(9, tau), pioneer())
    assert (histogram.risk == IMPASSABLE).all()
    assert not histogram.passable.any()


def test_a_pillar_to_the_left_closes_the_left_and_not_the_right():
    system = PolarRiskHistogram(pioneer())
    context = system.CreateDefaultContext()
    features = describe_terrain(scan([(0.7, 0.6, 1.0, 1.1)], np.zeros(3)), TerrainConfig())
    system.GetInputPort("features").FixValue(context, AbstractValue.Make(features))
    system.GetInputPort("traversability").FixValue(context, np.full(9, 0.06))
    histogram = system.GetOutputPort("histogram").Eval(context)
    closed = np.rad2deg(histogram.directions[~histogram.passable])
    assert len(closed) > 0
    assert (closed > 0).all()
    assert histogram.passable[4]


def test_another_number_of_rectangles_is_refused():
    system = PolarRiskHistogram(pioneer(), rectangles=5)
    context = system.CreateDefaultContext()
    system.GetInputPort("features").FixValue(context, AbstractValue.Make(flat_features()))
    system.GetInputPort("traversability").FixValue(context, np.full(5, 0.06))
    with pytest.raises(PortError, match=r"wrong number of rectangles, got 9 \(valid: 5\)"):
        system.GetOutputPort("histogram").Eval(context)
