import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.errors import InputError
from naraha.systems.routes import MotionModel, deterministic, from_outcomes, from_primitives, slipping
from naraha.systems.routes.motion_model import STEPS


def mean_motion(model, terrain, action):
    """Mean displacement (ahead, left) in cells and turn in 45° of an outcome list, from heading +x."""
    total = np.zeros(3)
    for p, cells, veer, turn in model.outcomes(terrain, action):
        total += p * np.array([*(cells * STEPS[veer % 8]), turn])
    return total


def test_ideal_motions_do_what_they_say():
    model = deterministic()
    assert model.is_deterministic
    assert model.outcomes("steps", "forward") == [(1.0, 1, 0, 0)]
    assert model.outcomes("flat", "left") == [(1.0, 0, 0, 1)]
    assert np.allclose(mean_motion(model, "flat", "back"), [-1, 0, 0])
    assert np.allclose(mean_motion(model, "flat", "right"), [0, 0, -1])


def test_measured_motions_that_are_exact_give_the_ideal_model():
    exact = {"forward": [[0.2, 0, 0]], "back": [[-0.2, 0, 0]], "left": [[0, 0, np.pi / 4]]}
    model = from_primitives({"flat": {name: np.array(rows) for name, rows in exact.items()}}, 0.2)
    for action in ("forward", "back", "left", "right"):
        assert np.allclose(mean_motion(model, "flat", action), mean_motion(deterministic(), "flat", action))


@given(st.lists(st.tuples(st.floats(0.7, 1.3), st.floats(-0.3, 0.3), st.floats(-0.4, 0.4)), min_size=1, max_size=30))
def test_the_mean_of_measured_motions_is_kept(samples):
    rows = np.array(samples) * [0.5, 0.5, np.pi / 4]
    model = from_primitives({"rough": {"forward": rows}}, 0.5, least=0.0)
    means = np.mean(samples, axis=0)
    got = mean_motion(model, "rough", "forward")
    # Two cells ahead and one aside has no outcome of its own: it becomes two ahead or two along the diagonal.
    assert np.allclose(got[[0, 2]], means[[0, 2]], atol=1e-6)
    assert abs(got[1] - means[1]) < 0.11


def test_terrain_that_was_not_measured_is_like_flat_ground():
    model = from_outcomes({"flat": {"forward": [(0.9, 1, 0, 0), (0.1, 0, 0, 0)]}, "steps": {}})
    assert model.outcomes("rough", "forward") == model.outcomes("flat", "forward")
    assert model.outcomes("steps", "forward") == [(1.0, 1, 0, 0)]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: from_outcomes({"lava": {}}), "unknown terrain"),
        (lambda: from_outcomes({"flat": {"jump": []}}), "unknown motion"),
        (lambda: from_outcomes({"flat": {"forward": [(0.5, 1, 0, 0)]}}), "add up to 1"),
        (lambda: from_primitives({"flat": {"forward": np.zeros((0, 3))}}, 0.2), "no usable samples"),
        (lambda: from_primitives({"flat": {"forward": np.array([[np.nan, 0, 0]])}}, 0.2), "no usable samples"),
        (lambda: from_primitives({}, 0.0), "step must be positive"),
        (lambda: MotionModel(np.ones((1, 1)), np.ones(1), np.ones(1), np.ones(1)), "wrong shape"),
    ],
)
def test_what_is_no_model_is_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_the_assumed_spread_is_a_spread():
    model = slipping(slip=0.1, veer=0.2)
    assert not model.is_deterministic
    expected = [(0.7, 1, 0, 0), (0.1, 1, 1, 0), (0.1, 1, -1, 0), (0.1, 0, 0, 0)]
    assert np.allclose(model.outcomes("flat", "forward"), expected)
    assert np.allclose(mean_motion(model, "flat", "back")[1], 0)
