import numpy as np
import pytest
from naraha.systems.drive import TrackDriver, TrackDriverConfig
from naraha.systems.errors import ConfigError, PortError
from pydrake.systems.analysis import Simulator

CONFIG = TrackDriverConfig(period=0.02, max_speed=0.3, max_acceleration=0.5, gauge=0.4)


def driver(config=CONFIG):
    return TrackDriver(
        config, ["robot::left_track", "robot::front_left_flipper"], ["robot::right_track", "robot::rear_right_flipper"]
    )


def simulate(system, **inputs):
    simulator = Simulator(system)
    for name, value in inputs.items():
        system.GetInputPort(name).FixValue(simulator.get_mutable_context(), np.array(value, dtype=float))
    return simulator


def speeds(system, simulator):
    return system.GetOutputPort("commanded_track_speeds").Eval(simulator.get_context())


def test_belts_are_at_rest_before_the_first_command():
    system = driver()
    np.testing.assert_array_equal(speeds(system, simulate(system)), 0)


def test_a_twist_becomes_track_speeds():
    system = driver()
    simulator = simulate(system, twist_command=[0.1, 0.5])
    simulator.AdvanceTo(2.0)
    np.testing.assert_allclose(speeds(system, simulator), [0.0, 0.2], atol=1e-12)


def test_track_speeds_pass_unchanged_inside_the_limits():
    system = driver()
    simulator = simulate(system, track_speed_command=[-0.1, 0.25])
    simulator.AdvanceTo(2.0)
    np.testing.assert_allclose(speeds(system, simulator), [-0.1, 0.25], atol=1e-12)


def test_too_fast_a_turn_is_slowed_with_its_curvature_kept():
    system = driver()
    simulator = simulate(system, twist_command=[0.6, 1.0])  # tracks 0.4 and 0.8
    simulator.AdvanceTo(2.0)
    np.testing.assert_allclose(speeds(system, simulator), [0.15, 0.3], atol=1e-12)


def test_speed_rises_by_the_acceleration_limit_every_period():
    system = driver()
    simulator = simulate(system, track_speed_command=[0.3, 0.15])
    # Samples at 0, 0.02, 0.04, 0.06 and 0.08 s have been taken.
    simulator.AdvanceTo(0.09)
    np.testing.assert_allclose(speeds(system, simulator), [0.05, 0.025], atol=1e-12)


@pytest.mark.parametrize("broken", [[np.nan, 0.0], [0.1, np.inf]])
def test_a_broken_command_stops_the_belts_with_the_ordinary_deceleration(broken):
    system = driver()
    simulator = simulate(system, twist_command=[0.2, 0.0])
    simulator.AdvanceTo(1.99)
    system.GetInputPort("twist_command").FixValue(simulator.get_mutable_context(), np.array(broken))
    simulator.AdvanceTo(2.05)  # three samples
    np.testing.assert_allclose(speeds(system, simulator), 0.2 - 3 * 0.5 * 0.02, atol=1e-12)
    simulator.AdvanceTo(3.0)
    np.testing.assert_allclose(speeds(system, simulator), 0.0, atol=1e-12)
    system.GetInputPort("twist_command").FixValue(simulator.get_mutable_context(), np.array([0.2, 0.0]))
    simulator.AdvanceTo(5.0)
    np.testing.assert_allclose(speeds(system, simulator), 0.2, atol=1e-12)


def test_flippers_run_with_the_track_of_their_side():
    system = driver()
    simulator = simulate(system, track_speed_command=[0.1, -0.2])
    simulator.AdvanceTo(2.0)
    bus = system.GetOutputPort("surface_speeds").Eval(simulator.get_context())
    assert {name: bus.Find(name) for name in bus} == pytest.approx(
        {
            "robot::left_track": 0.1,
            "robot::front_left_flipper": 0.1,
            "robot::right_track": -0.2,
            "robot::rear_right_flipper": -0.2,
        }
    )


def test_exactly_one_command_must_be_connected():
    system = driver()
    with pytest.raises(PortError, match="no input is connected"):
        simulate(system).AdvanceTo(0.1)
    with pytest.raises(PortError, match="exactly one of twist_command and track_speed_command"):
        simulate(system).AdvanceTo(0.1)
    with pytest.raises(PortError, match="both inputs are connected"):
        simulate(system, twist_command=[0, 0], track_speed_command=[0, 0]).AdvanceTo(0.1)


@pytest.mark.parametrize("key", ["period", "max_speed", "max_acceleration", "gauge"])
def test_limits_must_be_positive(key):
    with pytest.raises(ConfigError, match=key):
        TrackDriver(TrackDriverConfig(**{key: 0.0}))
