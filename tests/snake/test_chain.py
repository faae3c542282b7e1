import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.models.snake.snake_model import SnakeModel
from naraha.models.snake.urdf import snake_urdf
from naraha.systems.errors import ConfigError
from naraha.systems.snake.chain import ChainKinematics
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable

angles = st.lists(st.floats(-1.4, 1.4), min_size=9, max_size=9).map(np.array)
CHAIN = ChainKinematics(9, 0.09)


def differences(function, theta, step=1e-6):
    """∂f/∂θ_j in the last axis, by central differences."""
    steps = step * np.eye(len(theta))
    return np.stack([(np.asarray(function(theta + h)) - function(theta - h)) / (2 * step) for h in steps], axis=-1)


@given(theta=angles)
def test_the_jacobian_is_the_derivative_of_the_control_pose(theta):
    J = CHAIN.jacobian(theta)
    np.testing.assert_allclose(J[:3], differences(lambda t: CHAIN.control_pose(t)[1], theta), atol=1e-8)
    R = CHAIN.control_pose(theta)[0]
    dR = differences(lambda t: CHAIN.control_pose(t)[0], theta)
    spin = np.einsum("ikj,lk->ilj", dR, R)  # dR Rᵀ, the cross product matrix of the angular velocity
    np.testing.assert_allclose(J[3:], [spin[2, 1], spin[0, 2], spin[1, 0]], atol=1e-8)


@pytest.mark.parametrize("starts_with_yaw", [False, True])
@given(theta=angles)
def test_its_derivative_agrees_with_differences(starts_with_yaw, theta):
    chain = ChainKinematics(9, 0.09, starts_with_yaw=starts_with_yaw)
    np.testing.assert_allclose(chain.jacobian_derivative(theta), differences(chain.jacobian, theta), atol=1e-8)


@given(theta=angles)
def test_the_manipulability_gradient_agrees_with_the_derivative_of_the_jacobian(theta):
    J = CHAIN.jacobian(theta)
    if np.linalg.svd(J, compute_uv=False)[-1] < 1e-3:
        return
    expected = 2 * np.einsum("ir,rij->j", np.linalg.pinv(J), CHAIN.jacobian_derivative(theta))
    scale = 1 + np.abs(expected).max()
    np.testing.assert_allclose(CHAIN.log_manipulability_gradient(theta) / scale, expected / scale, atol=1e-9)


def test_the_manipulability_gradient_is_that_of_the_determinant():
    theta = 0.5 * np.random.default_rng(1).standard_normal(9)

    def log_det(t):
        return np.linalg.slogdet(CHAIN.jacobian(t) @ CHAIN.jacobian(t).T)[1]

    np.testing.assert_allclose(CHAIN.log_manipulability_gradient(theta), differences(log_det, theta), atol=1e-7)


@given(theta=angles, middle=st.integers(0, 8))
def test_the_distance_gradient_agrees_with_differences(theta, middle):
    target = np.array([-0.4, 0.1, 0.2])
    gradient = CHAIN.distance_gradient(theta, middle, target)

    def squared(t):
        return np.sum((CHAIN.positions(t)[middle] - target) ** 2)

    np.testing.assert_allclose(gradient, differences(squared, theta), atol=1e-8)


def test_a_straight_chain_is_stretched_and_singular():
    positions = CHAIN.positions(np.zeros(9))
    np.testing.assert_allclose(positions, np.column_stack([-0.09 * np.arange(9), np.zeros(9), np.zeros(9)]))
    assert CHAIN.manipulability(np.zeros(9)) == 0.0


def test_positive_pitch_raises_the_tail_and_positive_yaw_turns_it_right():
    bent = np.zeros(9)
    bent[0] = 0.3
    assert CHAIN.positions(bent)[-1, 2] > 0.1
    bent[:2] = 0.0, 0.3
    assert CHAIN.positions(bent)[-1, 1] < -0.1


@pytest.mark.parametrize(("first", "last"), [(3, 7), (0, 9), (2, 5)])
def test_positions_and_jacobian_are_those_of_the_plant(first, last):
    model = SnakeModel()
    plant = MultibodyPlant(0.005)
    Parser(plant).AddModelsFromString(snake_urdf(model), "urdf")
    plant.Finalize()
    context = plant.CreateDefaultContext()
    theta = 0.4 * np.random.default_rng(first).standard_normal(2 * model.units - 1)
    joints = [plant.GetJointByName(name) for name in model.joint_names()]
    for joint, angle in zip(joints, theta, strict=True):
        joint.set_angle(context, angle)
    segment = slice(2 * first, 2 * last + 1)
    chain = ChainKinematics(2 * (last - first) + 1, model.half_length)
    A, C = plant.GetFrameByName(f"F{first}"), plant.GetFrameByName(f"R{last}")
    p_joint = joints[2 * first].frame_on_parent().GetFixedPoseInBodyFrame().translation()
    X_AC = C.CalcPose(context, A)
    R_AC, p_AC = chain.control_pose(theta[segment])
    np.testing.assert_allclose(p_AC, X_AC.translation() - p_joint, atol=1e-12)
    np.testing.assert_allclose(R_AC, X_AC.rotation().matrix(), atol=1e-12)
    columns = [joint.velocity_start() for joint in joints[segment]]
    V = plant.CalcJacobianSpatialVelocity(context, JacobianWrtVariable.kV, C, np.zeros(3), A, A)[:, columns]
    np.testing.assert_allclose(chain.jacobian(theta[segment]), np.vstack([V[3:], V[:3]]), atol=1e-12)


def test_what_is_no_chain_is_refused():
    with pytest.raises(ConfigError, match="half_length"):
        ChainKinematics(5, float("nan"))
    with pytest.raises(ConfigError, match="joints"):
        ChainKinematics(0, 0.09)
    with pytest.raises(ConfigError, match="theta"):
        CHAIN.positions(np.zeros(8))
