import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.snake.inertial_speed import InertialSpeed, InertialSpeedConfig, turned_gravity

N = 3
CONFIG = InertialSpeedConfig()


def run(system, inputs, steps, context=None):
    """Calls the update `steps` times with the inputs that `inputs(k)` gives, and returns the context."""
    context = context or system.CreateDefaultContext()
    for k in range(steps):
        for name, value in inputs(k).items():
            system.GetInputPort(name).FixValue(context, value)
        context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context).value())
    return context


def still(pitch=0.0, offset=(0.0, 0.0, 0.0), command=0.0):
    force = 9.81 * np.array([-np.sin(pitch), 0.0, np.cos(pitch)]) + offset
    zero = np.zeros(2 * N)
    return {"gyro": np.zeros(3), "accelerometer": force, "wheel_speeds": zero, "wheel_speed_command": zero + command}


def speed(system, context):
    return system.GetOutputPort("forward_speed").Eval(context)[0]


@pytest.mark.parametrize("pitch", [0.0, 0.4, -0.3])
def test_the_integral_of_the_acceleration_is_the_speed_whatever_offset_and_slope(pitch):
    system = InertialSpeed(CONFIG, units=N)
    offset = np.array([0.05, 0.0, -0.02])
    context = run(system, lambda k: still(pitch, offset), 400)

    def speeding_up(k):
        values = still(pitch, offset, command=2.0)
        values["accelerometer"] = values["accelerometer"] + [0.5 if k < 40 else 0.0, 0, 0]
        values["wheel_speeds"] = np.full(2 * N, 2.0)
        return values

    context = run(system, speeding_up, 60, context)
    assert speed(system, context) == pytest.approx(0.1, abs=0.005)


def test_wheels_that_slip_do_not_make_a_speed_at_once():
    system = InertialSpeed(CONFIG, units=N)
    context = run(system, lambda k: still(), 400)
    slipping = lambda k: still(command=2.0) | {"wheel_speeds": np.full(2 * N, 2.0)}  # noqa: E731
    context = run(system, slipping, 400, context)
    assert 0 <= speed(system, context) < 0.03


def test_turning_while_driving_is_not_taken_for_an_acceleration():
    system = InertialSpeed(CONFIG, units=N)
    context = run(system, lambda k: still(), 400)
    rate, dt = 0.5, CONFIG.period

    def pitching(k):
        values = still(rate * dt * (k + 1), command=2.0)
        return values | {"gyro": np.array([0.0, rate, 0.0])}

    context = run(system, pitching, 200, context)
    assert abs(speed(system, context)) < 0.02


def test_a_reading_that_is_not_a_number_is_passed_over():
    system = InertialSpeed(CONFIG, units=N)
    context = run(system, lambda k: still(), 100)
    broken = lambda k: still(command=2.0) | {"accelerometer": np.full(3, np.nan)}  # noqa: E731
    assert np.isfinite(speed(system, run(system, broken, 5, context)))


@given(rate=st.tuples(*[st.floats(-3, 3)] * 3))
def test_a_vector_keeps_its_length_when_it_turns(rate):
    turned = turned_gravity(np.array([1.0, -2.0, 9.0]), np.array(rate), 0.005)
    assert np.linalg.norm(turned) == pytest.approx(np.sqrt(86.0))
