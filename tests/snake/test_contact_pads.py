import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.errors import ConfigError
from naraha.systems.snake.contact_pads import PAD_PLACES, ContactPads, ContactPadsConfig, pad_place, pad_reading
from pydrake.common.value import AbstractValue
from pydrake.multibody.plant import ContactResults

from tests.snake.stuck_snake import settled

CONFIG = ContactPadsConfig()


@given(force=st.floats(0, 200), gain=st.floats(0.5, 1.5), noise=st.floats(-1, 1))
def test_a_reading_is_zero_or_between_threshold_and_saturation(force, gain, noise):
    (reading,) = pad_reading(np.array([force]), np.array([gain]), np.array([noise]), CONFIG)
    assert reading == 0 or CONFIG.threshold <= reading <= CONFIG.saturation


def test_forces_below_the_threshold_are_not_felt_and_those_above_come_with_gain_and_noise():
    reading = pad_reading(np.array([0.2, 10.0, 80.0]), np.array([1.0, 1.1, 1.0]), np.array([0.0, 0.5, 0.0]), CONFIG)
    np.testing.assert_allclose(reading, [0.0, 11.5, 50.0])


def test_the_places_of_pads_follow_from_their_names():
    assert pad_place("pad_belly_1", "F") == "belly_front"
    assert pad_place("pad_belly_0", "R") == "belly_rear"
    assert pad_place("pad_left", "R") == "left"
    assert pad_place("pad_right", "F") == "right"
    assert pad_place("tyre", "F") is None


def test_the_pads_over_a_stone_feel_what_the_wheels_do_not_carry():
    case, run = settled(4, 0)
    pads = run.read("station.pad_forces").reshape(-1, len(PAD_PLACES))
    near = pads[case.unit - 1 : case.unit + 2, :2]
    assert near.sum() > 30
    assert pads.sum() == pytest.approx(near.sum())


def test_pads_read_next_to_nothing_without_contact():
    system = ContactPads(CONFIG, pads={}, units=3, seed=4)
    context = system.CreateDefaultContext()
    system.GetInputPort("contact_results").FixValue(context, AbstractValue.Make(ContactResults()))
    for sample in range(1, 30):
        context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context).value())
        assert context.get_discrete_state_vector().value()[-1] == sample
        assert np.all(system.GetOutputPort("pad_forces").Eval(context) < 6 * CONFIG.noise_std)
    assert system.GetOutputPort("pad_forces").Eval(context).max() == 0


def test_values_out_of_range_are_refused():
    with pytest.raises(ConfigError, match=r"pads\.noise_std"):
        ContactPads(ContactPadsConfig(noise_std=-1.0), pads={}, units=3)
