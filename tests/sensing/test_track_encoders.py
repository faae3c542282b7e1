import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.sensing.track_encoders import TrackEncoders, TrackEncodersConfig, encoder_counts
from pydrake.common.value import AbstractValue, Value
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BusValue, DiagramBuilder, LeafSystem

LEFT, RIGHT = "crawler::left_track", "crawler::right_track"


class _Belts(LeafSystem):
    """The plant's bus of displacements for belts that run with constant speeds from given starts."""

    def __init__(self, speeds, start=(0.0, 0.0)):
        super().__init__()
        self._speeds, self._start = np.array(speeds), np.array(start)
        self.DeclareAbstractOutputPort("surface_displacements", lambda: AbstractValue.Make(BusValue()), self._Calc)

    def _Calc(self, context, output):
        bus = BusValue()
        left, right = self._start + self._speeds * context.get_time()
        for name, value in ((LEFT, left), (RIGHT, right), ("crawler::front_left_flipper", 99.0)):
            bus.Set(name, Value(float(value)))
        output.set_value(bus)


def run(config, speeds, seconds, start=(0.0, 0.0)):
    """Displacements and speeds that the encoders say after `seconds`."""
    builder = DiagramBuilder()
    belts, encoders = builder.AddSystem(_Belts(speeds, start)), builder.AddSystem(TrackEncoders(config))
    builder.Connect(belts.get_output_port(), encoders.get_input_port())
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(seconds)
    context = encoders.GetMyContextFromRoot(simulator.get_context())
    return [encoders.GetOutputPort(name).Eval(context) for name in ("track_displacements", "track_speeds")]


@given(st.floats(-50, 50), st.floats(1e-5, 0.01))
def test_counting_errs_by_half_a_count_at_most(displacement, resolution):
    (count,) = encoder_counts(np.array([displacement]), np.zeros(1), resolution)
    assert count == int(count)
    assert abs(count * resolution - displacement) <= resolution / 2 * (1 + 1e-6)


def test_displacement_is_that_of_the_last_sample_in_whole_counts():
    config = TrackEncodersConfig(period=0.05, resolution=0.01)
    displacements, _ = run(config, [0.3, -0.1], 1.03)  # sampled at 1.0 s
    np.testing.assert_allclose(displacements, [0.30, -0.10], atol=1e-12)
    displacements, _ = run(config, [0.333, -0.0996], 1.03)
    np.testing.assert_allclose(displacements, [0.33, -0.10], atol=1e-12)


def test_speed_is_the_change_of_counts_in_a_period():
    config = TrackEncodersConfig(period=0.05, resolution=1e-6)
    _, speeds = run(config, [0.3, -0.1], 1.01)
    np.testing.assert_allclose(speeds, [0.3, -0.1], atol=1e-6 / 0.05)
    coarse = TrackEncodersConfig(period=0.05, resolution=0.01)
    _, speeds = run(coarse, [0.3, -0.1], 1.01)
    steps = speeds / (0.01 / 0.05)
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-9)


def test_belts_that_have_run_before_the_start_are_not_a_speed():
    displacements, speeds = run(TrackEncodersConfig(), [0.0, 0.0], 0.5, start=(3.0, -2.0))
    np.testing.assert_allclose(displacements, [3.0, -2.0], atol=1e-4)
    np.testing.assert_array_equal(speeds, 0)


def test_scale_errors_are_relative_differ_by_side_and_come_from_the_seed():
    config = TrackEncodersConfig(scale_error_std=0.05, seed=4, resolution=1e-6)
    displacements, _ = run(config, [1.0, 1.0], 2.01)  # sampled at 2 s
    errors = displacements / 2.0 - 1.0
    expected = np.random.default_rng(4).normal(0.0, 0.05, 2)
    np.testing.assert_allclose(errors, expected, atol=2e-6)
    assert abs(errors[0] - errors[1]) > 1e-3
    np.testing.assert_array_equal(run(config, [1.0, 1.0], 2.01)[0], displacements)
    other = TrackEncodersConfig(scale_error_std=0.05, seed=5, resolution=1e-6)
    assert np.abs(run(other, [1.0, 1.0], 2.01)[0] - displacements).min() > 1e-3


def test_without_scale_error_the_seed_does_not_matter():
    a = run(TrackEncodersConfig(seed=1), [0.2, 0.3], 1.0)
    b = run(TrackEncodersConfig(seed=2), [0.2, 0.3], 1.0)
    np.testing.assert_array_equal(a, b)


def test_a_bus_without_the_tracks_names_what_is_there():
    system = TrackEncoders(TrackEncodersConfig(), "tank::left_track", "tank::right_track")
    simulator = Simulator(system)
    bus = BusValue()
    bus.Set(LEFT, Value(1.0))
    system.get_input_port().FixValue(simulator.get_mutable_context(), Value(bus))
    with pytest.raises(PortError, match=r"crawler::left_track.*tank::left_track"):
        simulator.Initialize()


def test_an_unconnected_bus_is_named():
    with pytest.raises(PortError, match="surface_displacements"):
        Simulator(TrackEncoders(TrackEncodersConfig())).Initialize()


@pytest.mark.parametrize(("key", "value"), [("period", 0.0), ("resolution", -1e-3), ("scale_error_std", 0.9)])
def test_bad_values_are_refused_by_key(key, value):
    with pytest.raises(ConfigError, match=key):
        TrackEncoders(TrackEncodersConfig(**{key: value}))
