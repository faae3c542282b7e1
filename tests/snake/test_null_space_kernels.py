import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.errors import ConfigError
from naraha.systems.snake import ChainKinematics, NullSpaceConfig, preset
from naraha.systems.snake import null_space_kernels as kernel
from naraha.systems.snake.null_space_kernels import pose_error, recovery_tick
from naraha.systems.snake.recovery_motion import rotation_by
from scipy.optimize import LinearConstraint, minimize

CHAIN = ChainKinematics(9, 0.09)
LIMITS = np.full(9, 1.3)
TARGET = np.array([-0.3, 0.05, 0.15])
TWIST = np.array([0.05, 0.01, 0.0, 0.1, -0.05, 0.02])


def tick(theta, config, *, twist=TWIST, offset=None, limits=LIMITS):
    """Rates and report for a control point that is where it should be, but for `offset` [m]."""
    R, p = CHAIN.control_pose(theta)
    reference = np.concatenate([p if offset is None else p - offset, R.ravel(), twist])
    report = np.zeros(kernel.REPORT)
    return recovery_tick(theta, reference, TARGET, limits, config.settings(9, 0.09), report), report


def cost(theta, config):
    """V of row S1-b, as it is written there."""
    d = CHAIN.positions(theta)[4] - TARGET
    det = np.linalg.det(CHAIN.jacobian(theta) @ CHAIN.jacobian(theta).T)
    singular = -np.log(det) if config.singularity == "log" else 1 / det
    beyond = np.maximum(np.abs(theta) - (LIMITS - config.joint_margin), 0)
    return config.target_weight * d @ d + config.singular_weight * singular + config.joint_weight * np.mean(beyond**3)


def bent(seed):
    return 0.5 * np.random.default_rng(seed).standard_normal(9)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("name", ["paper", "naraha"])
def test_without_active_bounds_it_is_the_published_law(name, seed):
    theta = bent(seed)
    config = preset(
        name, alpha=-0.1, singular_weight=1e-9 if name == "paper" else 2e-4, max_joint_rate=50.0, damping=0.0
    )
    rates, report = tick(theta, config, limits=np.full(9, 3.0))
    J = CHAIN.jacobian(theta)
    pinv = np.linalg.pinv(J)
    steps = 1e-6 * np.eye(9)
    free = preset(name, singular_weight=config.singular_weight, joint_weight=0.0)
    eta = np.array([(cost(theta + h, free) - cost(theta - h, free)) / 2e-6 for h in steps])
    np.testing.assert_allclose(rates, pinv @ TWIST + (np.eye(9) - pinv @ J) @ (config.alpha * eta), atol=1e-6)
    assert report[kernel.AT_BOUND] == 0


def test_the_null_space_term_does_not_move_the_control_point():
    theta = bent(1)
    rates, _ = tick(theta, NullSpaceConfig(), twist=np.zeros(6))
    assert np.abs(rates).max() > 0.05
    np.testing.assert_allclose(CHAIN.jacobian(theta) @ rates, 0.0, atol=1e-9)


def test_the_null_space_term_lowers_the_cost():
    theta = bent(2)
    config = NullSpaceConfig()
    rates, _ = tick(theta, config, twist=np.zeros(6))
    assert cost(theta + 1e-3 * rates, config) < cost(theta, config)


def test_the_joint_term_acts_from_its_margin_on():
    theta = bent(3)
    theta[0] = LIMITS[0] - 0.05
    with_term, _ = tick(theta, NullSpaceConfig(joint_weight=300.0), twist=np.zeros(6))
    without, _ = tick(theta, NullSpaceConfig(joint_weight=0.0), twist=np.zeros(6))
    assert with_term[0] < without[0] - 1e-3


def test_an_error_of_the_control_point_decays_with_k():
    theta = bent(4)
    rates, report = tick(theta, NullSpaceConfig(k_position=3.0), twist=np.zeros(6), offset=np.array([0.002, 0, 0]))
    np.testing.assert_allclose((CHAIN.jacobian(theta) @ rates)[:3], [-0.006, 0, 0], atol=1e-8)
    np.testing.assert_allclose(report[:3], [0.002, 0, 0], atol=1e-12)


@given(seed=st.integers(0, 200), scale=st.floats(0.0, 1.5))
def test_rates_and_ranges_are_kept_by_construction(seed, scale):
    theta = np.clip(scale * np.random.default_rng(seed).standard_normal(9), -1.4, 1.4)
    config = NullSpaceConfig()
    rates, _ = tick(theta, config, twist=5 * TWIST)
    assert np.abs(rates).max() <= config.max_joint_rate + 1e-9
    after = theta + config.period * rates
    assert (np.abs(after) <= np.maximum(LIMITS, np.abs(theta)) + 1e-12).all()


@pytest.mark.parametrize("seed", range(4))
def test_with_active_bounds_it_is_the_nearest_motion_that_is_allowed(seed):
    theta = 0.8 * bent(seed)
    config = NullSpaceConfig(max_joint_rate=0.25, max_null_rate=0.5, singular_weight=0.0, joint_weight=0.0)
    rates, report = tick(theta, config, twist=0.5 * TWIST)
    wanted = config.alpha * CHAIN.distance_gradient(theta, 4, TARGET)
    wanted *= min(1.0, 0.5 / np.linalg.norm(wanted))
    J = CHAIN.jacobian(theta)
    task = LinearConstraint(J, 0.5 * TWIST, 0.5 * TWIST)
    best = minimize(lambda u: np.sum((u - wanted) ** 2), rates, constraints=task, bounds=[(-0.25, 0.25)] * 9)
    if report[kernel.RESIDUAL] < 1e-4:
        # Fixing the worst joint first is the optimum unless a joint would be let go again.
        assert np.sum((rates - wanted) ** 2) <= 1.2 * best.fun + 1e-9


def test_beyond_its_range_a_joint_comes_back():
    theta = bent(5)
    theta[3] = 1.45
    rates, _ = tick(theta, NullSpaceConfig(), twist=np.zeros(6))
    assert rates[3] < -0.1


def test_a_straight_pose_moves_with_damping_and_has_no_solution_without():
    rates, report = tick(np.zeros(9), NullSpaceConfig())
    assert np.isfinite(rates).all()
    assert np.abs(rates).max() > 0.05
    assert report[kernel.MANIPULABILITY] < 1e-9
    rates, report = tick(np.zeros(9), preset("paper"))
    assert report[kernel.SINGULAR] == 1
    np.testing.assert_array_equal(rates, 0.0)


def test_with_the_weights_of_the_paper_the_singular_term_drowns_the_target():
    theta = bent(6)
    both, _ = tick(theta, preset("paper"), twist=np.zeros(6))
    singular_alone, _ = tick(theta, preset("paper", target_weight=0.0), twist=np.zeros(6))
    assert np.linalg.norm(both - singular_alone) < 1e-3 * np.linalg.norm(both)


@given(vector=st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3).map(np.array))
def test_the_attitude_error_is_the_rotation_vector(vector):
    error = np.zeros(6)
    R_ref = rotation_by(np.array([0.3, -0.2, 0.5]))
    reference = np.concatenate([np.zeros(3), R_ref.ravel(), np.zeros(6)])
    pose_error(np.zeros(3), rotation_by(vector) @ R_ref, reference, error)
    np.testing.assert_allclose(error[3:], vector, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "changes", "key"),
    [
        ("papper", {}, "preset"),
        ("paper", {"gain": 1.0}, "gain"),
        ("naraha", {"alpha": 2.0}, "alpha"),
        ("naraha", {"singularity": "sqrt"}, "singularity"),
    ],
)
def test_unknown_presets_and_values_out_of_range_are_named(name, changes, key):
    with pytest.raises(ConfigError, match=key):
        preset(name, **changes)
