import numpy as np
import pytest
from naraha.systems.behaviors import FuzzyRule, FuzzyRules, RuleBase, read_behaviors
from naraha.systems.errors import ConfigError

from tests.behaviors.cluttered_room import BEHAVIORS


def rules(**changes):
    """One input in [0, 1] with two terms, and two outputs."""
    terms = {"x": {"low": [0.0, 0.5], "high": [1.0, 0.5]}}
    given = [FuzzyRule(when=["low"], then=[1.0, 0.0]), FuzzyRule(when=["high"], then=[3.0, -2.0])]
    return FuzzyRules(**{"inputs": terms, "rules": given, **changes})


def test_an_output_is_the_mean_of_the_conclusions_weighted_by_the_products():
    base = RuleBase(rules(), ("x",), 2)
    np.testing.assert_allclose(base.infer(np.array([0.5])), [2.0, -1.0])
    low, high = np.exp(-((0.2 / 0.5) ** 2)), np.exp(-((0.8 / 0.5) ** 2))
    np.testing.assert_allclose(base.infer(np.array([0.2])), [(low + 3 * high) / (low + high), -2 * high / (low + high)])


def test_with_two_inputs_the_premises_are_multiplied_and_any_holds_always():
    inputs = {"x": {"low": [0.0, 0.5], "high": [1.0, 0.5]}, "y": {"few": [0.0, 1.0], "many": [1.0, 1.0]}}
    given = [
        FuzzyRule(when=["low", "any"], then=[0.0]),
        FuzzyRule(when=["high", "few"], then=[1.0]),
        FuzzyRule(when=["high", "many"], then=[2.0]),
    ]
    base = RuleBase(FuzzyRules(inputs=inputs, rules=given), ("x", "y"), 1)
    x, y = 0.7, 0.25
    low, high = np.exp(-((np.array([x, x - 1]) / 0.5) ** 2))
    few, many = np.exp(-((np.array([y, y - 1])) ** 2))
    expected = (high * few + 2 * high * many) / (low + high * few + high * many)
    np.testing.assert_allclose(base.infer(np.array([x, y])), [expected])


@pytest.mark.parametrize("x", [-np.inf, -1e9, 0.0])
def test_beyond_the_outer_terms_nothing_changes(x):
    base = RuleBase(rules(), ("x",), 2)
    np.testing.assert_array_equal(base.infer(np.array([x])), base.infer(np.array([0.0])))
    np.testing.assert_array_equal(base.infer(np.array([np.nan])), base.infer(np.array([1.0])))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"inputs": {"y": {"low": [0, 1]}}}, "inputs: wrong inputs"),
        ({"inputs": {"x": {"low": [0.0, 0.0], "high": [1.0, 0.5]}}}, "inputs.x.low: not a term"),
        ({"inputs": {"x": {"low": [1.0, 0.5], "high": [0.0, 0.5]}}}, "inputs.x.high: centres must rise"),
        ({"inputs": {"x": {"low": [0.0, 0.1], "high": [1.0, 0.1]}}}, "inputs.x: a gap between terms"),
        ({"inputs": {"x": {}}}, "inputs.x: no terms"),
        ({"rules": []}, "rules.rules: no rules"),
        ({"rules": [FuzzyRule(when=["low"], then=[1.0, 0.0])]}, "a rule is missing"),
        ({"rules": [FuzzyRule(when=["tall"], then=[1.0, 0.0])]}, r"rules\[0\].when: unknown term"),
        ({"rules": [FuzzyRule(when=["low"], then=[1.0])]}, r"rules\[0\].then: wrong length"),
        ({"rules": [FuzzyRule(when=[], then=[1.0, 0.0])]}, r"rules\[0\].when: wrong length"),
        ({"rules": [FuzzyRule(when=["any"], then=[np.nan, 0.0])]}, r"rules\[0\].then: out of range"),
    ],
)
def test_rules_that_are_none_are_refused(changes, words):
    with pytest.raises(ConfigError, match=words):
        RuleBase(rules(**changes), ("x",), 2)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[1, 2]", "not behaviours"),
        ("goal_seeking: {colour: red}", "not behaviours"),
        ("coordinator: {radius: -1}", "coordinator.radius: out of range"),
        ("{}", "goal_seeking.inputs: wrong inputs"),
    ],
)
def test_a_file_that_is_wrong_is_named(tmp_path, text, words):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=words) as caught:
        read_behaviors(path)
    assert str(path) in str(caught.value)


def test_the_shipped_rules_turn_to_the_goal_and_slow_down_before_it():
    base = RuleBase(read_behaviors(BEHAVIORS).goal_seeking, ("distance", "bearing"), 2)
    for bearing in (0.1, 0.4, 1.0, 2.0, 3.0):
        left, right = base.infer(np.array([3.0, bearing])), base.infer(np.array([3.0, -bearing]))
        assert left[1] > 0
        np.testing.assert_allclose(left, right * [1, -1], atol=1e-9)
    speeds = [base.infer(np.array([distance, 0.0]))[0] for distance in (0.05, 0.3, 0.8, 3.0)]
    assert np.all(np.diff(speeds) > 0)
    assert speeds[0] < 0.15
    assert speeds[-1] > 0.7
