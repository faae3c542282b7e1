import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.errors import ConfigError
from naraha.systems.tracking import KanayamaConfig, KanayamaTracking, kanayama_law, planar_pose, pose_error
from pydrake.math import RigidTransform, RollPitchYaw

CONFIG = KanayamaConfig(max_speed=10.0, max_yaw_rate=10.0)
angle = st.floats(-np.pi, np.pi)
length = st.floats(-2, 2)


def test_equation_8_by_hand():
    v, omega = kanayama_law(np.array([0.2, -0.1, 0.3]), 0.5, 0.1, CONFIG)
    assert v == pytest.approx(0.5 * np.cos(0.3) + 1.0 * 0.2)
    assert omega == pytest.approx(0.1 + 0.5 * (4.0 * -0.1 + 4.0 * np.sin(0.3)))


@given(x=length, y=length, theta=angle, v_r=st.floats(0, 3))
def test_saturation_keeps_the_curvature(x, y, theta, v_r):
    error = np.array([x, y, theta])
    free = kanayama_law(error, v_r, 0.0, KanayamaConfig(max_speed=1e6, max_yaw_rate=1e6))
    held = kanayama_law(error, v_r, 0.0, KanayamaConfig())
    assert abs(held[0]) <= 0.3 * (1 + 1e-9)
    assert abs(held[1]) <= 0.8 * (1 + 1e-9)
    assert free[0] * held[1] == pytest.approx(free[1] * held[0], abs=1e-6 * (1 + np.abs(free).max()))


@given(x=length, y=length, theta=angle, turn=angle)
def test_pose_error_is_seen_from_the_robot_whatever_the_frame(x, y, theta, turn):
    c, s = np.cos(turn), np.sin(turn)
    rotate = lambda p: np.array([c * p[0] - s * p[1], s * p[0] + c * p[1], p[2] + turn])  # noqa: E731
    pose, reference = np.array([0.3, -0.2, 0.4]), np.array([x, y, theta])
    before, after = pose_error(pose, reference), pose_error(rotate(pose), rotate(reference))
    np.testing.assert_allclose(before[:2], after[:2], atol=1e-9)
    assert np.cos(before[2] - after[2]) == pytest.approx(1)


def test_the_lyapunov_function_decreases_and_the_robot_converges_from_many_starts():
    rng = np.random.default_rng(0)
    dt, v_r = 0.01, 0.3
    for _ in range(20):
        robot = np.array([rng.uniform(-0.5, 0.5), rng.uniform(-1, 1), rng.uniform(-1.2, 1.2)])
        reference = np.zeros(3)
        value = []
        for _ in range(6000):
            x_e, y_e, theta_e = error = pose_error(robot, reference)
            value.append((x_e**2 + y_e**2) / 2 + (1 - np.cos(theta_e)) / CONFIG.k_y)
            v, omega = kanayama_law(error, v_r, 0.0, CONFIG)
            middle = robot[2] + omega * dt / 2
            robot = robot + dt * np.array([v * np.cos(middle), v * np.sin(middle), omega])
            reference = reference + dt * np.array([v_r, 0, 0])
        assert (np.diff(value) < 1e-6).all()
        assert np.abs(pose_error(robot, reference)).max() < 0.01


def test_planar_pose_takes_the_heading_from_above_on_a_slope():
    X_MB = RigidTransform(RollPitchYaw(0.1, -0.5, 0.7), [1, 2, 3])
    np.testing.assert_allclose(planar_pose(X_MB), [1, 2, 0.7], atol=1e-12)


def test_system_computes_the_law_from_its_ports():
    system = KanayamaTracking(KanayamaConfig())
    context = system.CreateDefaultContext()
    system.GetInputPort("X_MB").FixValue(context, RigidTransform(RollPitchYaw(0, 0, 0.1), [0, 0.05, 0]))
    system.GetInputPort("reference_pose").FixValue(context, [0, 0, 0])
    system.GetInputPort("reference_twist").FixValue(context, [0.2, 0])
    error = pose_error(np.array([0, 0.05, 0.1]), np.zeros(3))
    expected = kanayama_law(error, 0.2, 0, KanayamaConfig())
    np.testing.assert_allclose(system.GetOutputPort("twist_command").Eval(context), expected)


def test_a_negative_gain_names_its_key():
    with pytest.raises(ConfigError, match=r"kanayama\.k_y: out of range, got -1\.0"):
        KanayamaTracking(KanayamaConfig(k_y=-1.0))
