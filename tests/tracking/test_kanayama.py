import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.errors import ConfigError
from naraha.systems.tracking import KanayamaConfig, KanayamaTracking, kanayama_law, planar_pose, pose_error
from naraha.systems.tracking.kanayama import gain_share
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


def lyapunov(error, config):
    x_e, y_e, theta_e = error
    return (x_e**2 + y_e**2) / 2 + (1 - np.cos(theta_e)) / config.k_y


def moved(pose, v, omega, dt):
    middle = pose[2] + omega * dt / 2
    return pose + dt * np.array([v * np.cos(middle), v * np.sin(middle), omega])


@given(x=length, y=length, theta=angle, v_r=st.floats(0, 1), omega_r=st.floats(-1, 1))
def test_the_lyapunov_function_falls_at_the_rate_of_its_closed_form(x, y, theta, v_r, omega_r):
    error, dt = np.array([x, y, theta]), 1e-6
    v, omega = kanayama_law(error, v_r, omega_r, KanayamaConfig(max_speed=1e6, max_yaw_rate=1e6))
    reference = np.array([x, y, theta])
    before = lyapunov(pose_error(np.zeros(3), reference), CONFIG)
    later = pose_error(moved(np.zeros(3), v, omega, dt), moved(reference, v_r, omega_r, dt))
    rate = -CONFIG.k_x * x**2 - v_r * CONFIG.k_theta * np.sin(theta) ** 2 / CONFIG.k_y
    assert (lyapunov(later, CONFIG) - before) / dt == pytest.approx(rate, abs=1e-3)


def test_the_lyapunov_function_decreases_and_the_robot_converges_from_200_starts():
    rng = np.random.default_rng(0)
    dt, v_r = 0.04, 0.3
    for _ in range(200):
        robot, reference, last = rng.uniform([-1, -1, -3], [1, 1, 3]), np.zeros(3), np.inf
        for _ in range(1000):
            error = pose_error(robot, reference)
            # The command is held for a step, so that the decrease holds up to the square of the step's length.
            assert lyapunov(error, CONFIG) < last + dt**2 / 4
            last = lyapunov(error, CONFIG)
            if np.abs(error).max() < 0.01:
                break
            robot = moved(robot, *kanayama_law(error, v_r, 0.0, CONFIG), dt)
            reference = moved(reference, v_r, 0.0, dt)
        assert np.abs(error).max() < 0.01


def circle(t):
    return 0.3, 0.3 / 1.5


def figure_eight(t):
    """Speed and yaw rate along x = sin(s), y = sin(s) cos(s) times 2 m, with s = 0.1 t."""
    s, rate, size = 0.1 * t, 0.1, 2.0
    dx, dy = size * np.cos(s) * rate, size * np.cos(2 * s) * rate
    ddx, ddy = -size * np.sin(s) * rate**2, -2 * size * np.sin(2 * s) * rate**2
    return np.hypot(dx, dy), (dx * ddy - dy * ddx) / (dx**2 + dy**2)


@pytest.mark.parametrize("path", [circle, figure_eight])
def test_a_curved_reference_is_followed_without_lag_after_an_offset(path):
    dt = 0.02
    reference = np.array([0.0, 0.0, 0.0 if path is circle else np.pi / 4])
    robot, distance, value = reference + np.array([-0.2, 0.2, 0.4]), [], []
    for n in range(round(2 * np.pi / 0.1 / dt)):
        error = pose_error(robot, reference)
        distance.append(np.hypot(*error[:2]))
        value.append(lyapunov(error, CONFIG))
        v_r, omega_r = path((n + 0.5) * dt)
        robot = moved(robot, *kanayama_law(error, v_r, omega_r, CONFIG), dt)
        reference = moved(reference, v_r, omega_r, dt)
    assert (np.diff(value) < 1e-4).all()
    assert max(distance[len(distance) // 2 :]) < 0.005


def test_a_reference_that_slows_down_ends_in_rest_without_orbit_or_chatter():
    dt, goal = 0.02, 2.0
    robot, reference, twists = np.array([-0.2, 0.15, 0.3]), np.zeros(3), []
    for _ in range(3000):
        v_r = min(0.3, np.sqrt(0.2 * max(goal - reference[0], 0.0)))
        twist = kanayama_law(pose_error(robot, reference), v_r, 0.0, KanayamaConfig())
        twists.append(twist)
        robot, reference = moved(robot, *twist, dt), moved(reference, v_r, 0.0, dt)
    assert np.hypot(*(robot[:2] - [goal, 0])) < 0.05
    assert np.abs(twists[-500:]).max() < 1e-3
    assert (np.diff(np.sign(np.array(twists)[1500:, 1])) != 0).sum() <= 1


def test_a_reference_at_rest_beside_the_robot_does_not_make_it_turn():
    v, omega = kanayama_law(np.array([0.0, 0.5, 0.4]), 0.0, 0.0, KanayamaConfig())
    assert (v, omega) == (0, 0)


@pytest.mark.parametrize(
    ("risk", "share"), [(0, 1), (17, 0.8), (42.5, 0.5), (84, 0.1), (85, 0.1), (1e3, 0.1), (np.nan, 0.1), (-5, 1)]
)
def test_equation_9_by_hand_and_never_without_a_rest(risk, share):
    assert gain_share(risk, 85, 0.1) == pytest.approx(share)


def command_at(risk, **config):
    """v and omega towards a sub-goal 1 m ahead and a little to the left, on ground of this risk."""
    config = KanayamaConfig(max_speed=5.0, max_yaw_rate=5.0, **config)
    system = KanayamaTracking(config)
    context = system.CreateDefaultContext()
    system.GetInputPort("X_MB").FixValue(context, RigidTransform())
    system.GetInputPort("reference_pose").FixValue(context, [1.0, 0.1, 0.1])
    system.GetInputPort("reference_twist").FixValue(context, [0.2, 0])
    if system.HasInputPort("risk"):
        system.GetInputPort("risk").FixValue(context, [risk])
    return system.GetOutputPort("twist_command").Eval(context).copy()


def test_with_equation_9_the_robot_is_slower_near_risk_and_with_a_fixed_gain_it_is_not():
    # The gains of Fig. 12: 1.0 with Eq. 9 and 0.8 fixed are the same on flat ground, of risk 17 at a limit of 85.
    flat, risky = (command_at(risk, k_x=1.0, risk_limit=85.0) for risk in (17.0, 68.0))
    fixed = command_at(np.nan, k_x=0.8)
    np.testing.assert_allclose(flat, fixed)
    assert flat[0] - risky[0] == pytest.approx(0.6)
    assert risky[1] == pytest.approx(flat[1])
    assert not KanayamaTracking(KanayamaConfig()).HasInputPort("risk")


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
