"""Attribute ICP of the paper: the lifted search is the paper's cost, and classes decide where shape does not."""

import numpy as np
import pytest
from naraha.systems.errors import InputError
from naraha.systems.registration.attribute_icp import (
    AttributeIcpConfig,
    ClassSearch,
    attribute_icp,
    rare_classes,
)
from pydrake.math import RigidTransform, RollPitchYaw


def _brute_force(points, classes, targets, ids, penalty, radius):
    """The paper's rule, written down as it is: of all within the radius, the one of least cost."""
    square = ((points[:, None] - targets[None]) ** 2).sum(axis=2)
    cost = np.where(square <= radius[:, None] ** 2, square + penalty * (classes[:, None] != ids[None]), np.inf)
    best = cost.argmin(axis=1)
    return np.where(np.isfinite(cost.min(axis=1)), best, -1), cost.min(axis=1)


@pytest.mark.parametrize("penalty", [0.0, 0.02, 0.25, 4.0])
def test_lifted_query_is_the_papers_cost(penalty):
    rng = np.random.default_rng(0)
    points, targets = rng.uniform(0, 2, (400, 3)), rng.uniform(0, 2, (300, 3))
    classes, ids = rng.integers(0, 5, 400), rng.integers(0, 4, 300)  # 4 is in the source alone
    radius = rng.choice([0.15, 0.4], 400)
    partner, cost = ClassSearch(targets, ids, penalty)(points, classes, radius)
    expected, least = _brute_force(points, classes, targets, ids, penalty, radius)
    assert (expected == -1).any()
    assert (expected >= 0).any()
    np.testing.assert_array_equal(partner, expected)
    np.testing.assert_allclose(cost[partner >= 0], least[partner >= 0])


def _wall(rng, count, patches, half=3.0):
    """A flat wall with patches of class 1: shape says nothing of a shift along it."""
    points = np.column_stack([rng.uniform(-half, half, count), rng.uniform(0, 2, count), np.zeros(count)])
    inside = (np.abs(points[:, None, :2] - patches[None]) < 0.2).all(axis=2).any(axis=1)
    return points, inside.astype(int)


def test_classes_hold_a_shift_along_a_wall_that_shape_leaves_open():
    patches = np.array([[-1.6, 0.5], [0.1, 1.4], [1.3, 0.8]])
    target, target_ids = _wall(np.random.default_rng(1), 4000, patches)
    source, source_ids = _wall(np.random.default_rng(2), 3000, patches, half=2.4)
    X0 = RigidTransform([0.4, 0, 0.05])
    with_classes = attribute_icp(source, source_ids, target, target_ids, X0)
    without = attribute_icp(source, np.zeros(len(source)), target, np.zeros(len(target)), X0)
    assert abs(with_classes.X_TS.translation()[0]) < 0.2  # most of the way: unmarked points hold it back
    assert without.X_TS.translation()[0] > 0.3
    assert abs(with_classes.X_TS.translation()[2]) < 1e-9


def test_recovers_a_rotated_and_shifted_room_exactly_from_its_own_points():
    rng = np.random.default_rng(3)
    target = rng.uniform(-2, 2, (1500, 3))
    target[np.arange(1500), rng.integers(0, 3, 1500)] = rng.choice([-2, 2], 1500)
    ids = rng.integers(0, 4, 1500)
    X_TS = RigidTransform(RollPitchYaw(0.02, -0.03, 0.05), [0.1, -0.05, 0.03])
    source = X_TS.inverse().multiply(target.T).T
    result = attribute_icp(source, ids, target, ids, RigidTransform())
    assert result.converged
    np.testing.assert_allclose(result.X_TS.GetAsMatrix4(), X_TS.GetAsMatrix4(), atol=1e-9)
    assert result.cost == pytest.approx(0, abs=1e-9)
    assert len(result.pairs) == 1500


def test_rare_classes_come_from_counts_and_search_wider():
    assert rare_classes(np.zeros(95), np.repeat([1, 2], [4, 100]), 0.1).tolist() == [1]
    target, ids = np.array([[0.0, 0, 0], [0, 3, 0], [3, 0, 0], [0, 0, 3]]), np.zeros(4)
    far = target + np.array([0.8, 0, 0])
    config = AttributeIcpConfig(radius=0.5, rare_radius=1.0, rare_share=0.3)
    assert len(attribute_icp(far, ids, target, ids, RigidTransform(), config).pairs) == 0
    source_ids, target_ids = np.array([1, 1, 1, 0]), np.array([1, 1, 1, 0])
    more = np.vstack([target, np.tile([[20.0, 0, 0]], (20, 1))])
    target_ids = np.concatenate([target_ids, np.zeros(20)])
    result = attribute_icp(far, source_ids, more, target_ids, RigidTransform(), config)
    np.testing.assert_allclose(result.X_TS.translation(), [-0.8, 0, 0], atol=1e-9)


def test_too_few_pairs_return_the_guess_and_bad_input_raises():
    X0 = RigidTransform([5.0, 0, 0])
    points = np.eye(3)
    result = attribute_icp(points, np.zeros(3), points, np.zeros(3), X0)
    assert result.X_TS.IsExactlyEqualTo(X0)
    assert not result.converged
    assert len(result.pairs) == 0
    with pytest.raises(InputError, match="do not fit"):
        attribute_icp(points, np.zeros(2), points, np.zeros(3), X0)
    with pytest.raises(InputError, match="nothing to lay it on"):
        attribute_icp(points, np.zeros(3), np.zeros((0, 3)), np.zeros(0), X0)
