"""Odometry of S0-e: the equations of the paper, and circles, slopes and wraps in closed form."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.slam import Odometry6Dof, OdometryConfig, propagate, rotation
from naraha.systems.slam.odometry import wrap
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import TrajectorySource, VectorLogSink
from pydrake.trajectories import PiecewisePolynomial

angles = st.floats(-3.0, 3.0)
steps = st.floats(-0.5, 0.5)


@given(psi=angles, theta=angles, phi=angles)
def test_eq_6_is_roll_then_pitch_then_yaw(psi, theta, phi):
    np.testing.assert_allclose(
        rotation(psi, theta, phi), RollPitchYaw(psi, theta, phi).ToRotationMatrix().matrix(), atol=1e-12
    )


@given(x=st.tuples(*[angles] * 6), u=st.tuples(*[steps] * 6))
def test_eq_5_turns_the_step_by_the_angles_half_way(x, u):
    x, u = np.array(x), np.array(u)
    after = propagate(x, u)
    R = RollPitchYaw(x[3:] + u[3:] / 2).ToRotationMatrix().matrix()
    np.testing.assert_allclose(after[:3], x[:3] + R @ u[:3], atol=1e-12)
    np.testing.assert_allclose(after[3:], x[3:] + u[3:], atol=1e-12)


def test_eq_3_as_printed_differs_from_eq_6_in_two_terms_and_is_no_rotation():
    """Why Eq. 5 and 6 are followed: psi, theta, phi are 1, 2, 3 below."""
    (s1, s2, s3), (c1, c2, c3) = np.sin([0.3, -0.5, 1.1]), np.cos([0.3, -0.5, 1.1])
    printed = np.array(
        [
            [c3 * c2, c3 * s2 * s1 - s3 * c1, c3 * s2 * c1 + s3 * s1],
            [s3 * c2, c3 * s2 * s1 - s3 * c1, s3 * s2 * c1 - s3 * s1],
            [-s2, c2 * s1, c2 * c1],
        ]
    )
    ours = rotation(0.3, -0.5, 1.1)
    np.testing.assert_array_equal(
        np.isclose(printed, ours, atol=1e-12), [[True, True, True], [True, False, False], [True, True, True]]
    )
    np.testing.assert_allclose(ours @ ours.T, np.eye(3), atol=1e-12)
    assert np.abs(printed @ printed.T - np.eye(3)).max() > 0.1


@pytest.mark.parametrize("angle", [0.0, np.pi - 1e-9, -np.pi, 3 * np.pi, 7.0])
def test_wrapped_angles_are_the_same_direction_in_the_first_turn(angle):
    wrapped = wrap(np.array([angle]))[0]
    assert -np.pi <= wrapped < np.pi
    assert np.exp(1j * wrapped) == pytest.approx(np.exp(1j * angle))


def drive(tracks, rpy, duration, period=0.02, X_OB0=None):
    """Runs the odometry on readings given as functions of time; returns its times and states."""
    builder = DiagramBuilder()
    times = np.arange(0, duration + 1e-9, 0.005)
    odometry = builder.AddSystem(Odometry6Dof(OdometryConfig(period=period), X_OB0))
    for name, function in (("track_displacements", tracks), ("rpy", rpy)):
        values = np.array([function(t) for t in times]).T
        source = builder.AddSystem(TrajectorySource(PiecewisePolynomial.ZeroOrderHold(times, values)))
        builder.Connect(source.get_output_port(), odometry.GetInputPort(name))
    log = builder.AddSystem(VectorLogSink(6, period))
    builder.Connect(odometry.GetOutputPort("state"), log.get_input_port())
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(duration)
    states = log.FindLog(simulator.get_context()).data()
    return log.FindLog(simulator.get_context()).sample_times(), states, odometry, diagram, simulator.get_context()


def test_a_circle_closes_to_the_chord_error():
    """Radius 2 m in 10 s: chords instead of arcs lose Δφ²/24 of each step."""
    speed, rate = 2 * np.pi * 2 / 10, 2 * np.pi / 10
    times, states, *_ = drive(
        lambda t: [speed * t, speed * t], lambda t: [0, 0, (rate * t + np.pi) % (2 * np.pi) - np.pi], duration=10.02
    )
    # The state at an update is that of the readings one period before.
    t = times[2:] - 0.02
    expected = 2 * np.stack([np.sin(rate * t), 1 - np.cos(rate * t)])
    np.testing.assert_allclose(states[:2, 2:], expected, atol=4 * (rate * 0.02) ** 2 / 24 + 1e-9)
    np.testing.assert_allclose(states[5, 2:], rate * t, atol=1e-9)
    np.testing.assert_allclose(states[2], 0, atol=1e-12)


def test_up_a_slope_the_way_goes_into_height():
    X_OB0 = RigidTransform(RollPitchYaw(0, -0.3, 0.5), [1, 2, 3])
    _, states, *_ = drive(lambda t: [0.4 * t, 0.6 * t], lambda t: [0, -0.3, 0.5], 2.0, X_OB0=X_OB0)
    way = 0.5 * (2.0 - 2 * 0.02)
    expected = np.array([1, 2, 3]) + way * np.array([np.cos(0.3) * np.cos(0.5), np.cos(0.3) * np.sin(0.5), np.sin(0.3)])
    np.testing.assert_allclose(states[:3, -1], expected, atol=0.02)
    np.testing.assert_allclose(states[3:, -1], [0, -0.3, 0.5], atol=1e-12)


def test_the_first_update_only_takes_the_readings():
    """Encoders and IMU may start anywhere: only what changes afterwards moves the robot."""
    _, states, *_ = drive(lambda t: [123.0, -45.0], lambda t: [0.1, 0.2, 3.0], 0.5)
    np.testing.assert_array_equal(states, 0)


def test_turning_in_place_does_not_move_it():
    _, states, *_ = drive(lambda t: [-0.3 * t, 0.3 * t], lambda t: [0, 0, 0.8 * t], 1.0)
    np.testing.assert_allclose(states[:3], 0, atol=1e-12)
    assert states[5, -1] > 0.7


def test_the_pose_port_is_the_state():
    X_OB0 = RigidTransform(RollPitchYaw(0.1, -0.2, 2.0), [1, 2, 3])
    *_, odometry, diagram, context = drive(lambda t: [0.5 * t, 0.5 * t], lambda t: [0.2 * t, 0, t], 1.0, X_OB0=X_OB0)
    context = odometry.GetMyContextFromRoot(context)
    X_OB, x = odometry.GetOutputPort("X_OB").Eval(context), odometry.GetOutputPort("state").Eval(context)
    np.testing.assert_allclose(X_OB.translation(), x[:3])
    np.testing.assert_allclose(X_OB.rotation().matrix(), rotation(*x[3:]), atol=1e-12)
    start = odometry.GetOutputPort("X_OB").Eval(odometry.GetMyContextFromRoot(diagram.CreateDefaultContext()))
    assert start.IsNearlyEqualTo(X_OB0, 1e-12)


def test_a_missing_input_and_a_bad_period_are_named():
    odometry = Odometry6Dof()
    simulator = Simulator(odometry)
    odometry.GetInputPort("track_displacements").FixValue(simulator.get_mutable_context(), [0.0, 0.0])
    with pytest.raises(PortError, match=r"Odometry6Dof.rpy: input port is not connected"):
        simulator.AdvanceTo(0.1)
    with pytest.raises(ConfigError, match="period: out of range"):
        Odometry6Dof(OdometryConfig(period=0.0))
