"""Which motions surfaces hold, in closed form, and taking the others from the guess."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.registration import constraint, undo_unheld_motion
from pydrake.math import RigidTransform

from tests.rooms import corridor, pose, room_points


def test_the_constraint_of_a_cube_is_the_one_by_hand():
    """Points on the faces of a cube: any shift is felt by one pair of faces out of three."""
    rng = np.random.default_rng(8)
    count = 60000
    points, axis = rng.uniform(-1, 1, (count, 3)), rng.integers(0, 3, count)
    points[np.arange(count), axis] = rng.choice([-1, 1], count)
    normals = np.eye(3)[axis]
    values, motions = constraint(points, normals)
    # A turn about an axis: a third of the points moves in the plane of its face and is not felt; the others move by
    # |d|² = 1 + u² and are felt by u²: (2/3 · 1/3) / (2/3 · 4/3 + 1/3 · 2/3) = 1/5.
    np.testing.assert_allclose(values, [0.2, 0.2, 0.2, 1 / 3, 1 / 3, 1 / 3], atol=0.01)
    assert np.abs(motions[:3, :3]).max() > 10 * np.abs(motions[3:, :3]).max()


@pytest.mark.parametrize(("scale", "shift"), [(1.0, 0.0), (50.0, 0.0), (1.0, 1000.0)])
def test_the_constraint_has_no_unit_and_no_origin(scale, shift):
    rng = np.random.default_rng(9)
    points = corridor(rng, 4000)
    normals = np.where(np.abs(points) == 1.2, 1.0, 0.0)
    values, motions = constraint(scale * points + shift, normals)
    np.testing.assert_allclose(values, constraint(points, normals)[0], atol=1e-6)
    assert values[0] < 1e-6
    assert np.abs(motions[3, 0]) > 0.99


@given(seed=st.integers(0, 1000))
def test_every_value_is_a_part_between_none_and_all(seed):
    rng = np.random.default_rng(seed)
    normals = rng.normal(0, 1, (50, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    values, _ = constraint(rng.normal(0, 3, (50, 3)), normals)
    assert values.min() > -1e-9
    assert values.max() < 1 + 1e-9
    assert (np.diff(values) >= 0).all()


def test_points_on_one_line_do_not_break_it():
    points = np.column_stack([np.linspace(0, 1, 20), np.zeros((20, 2))])
    values, _ = constraint(points, np.tile([0.0, 0.0, 1.0], (20, 1)))
    assert np.isfinite(values).all()


small = st.tuples(*[st.floats(-0.02, 0.02)] * 3, *[st.floats(-0.3, 0.3)] * 3)


@given(change=small, x=st.floats(-20, 20))
def test_what_is_held_is_kept_and_what_is_not_is_the_guess(change, x):
    walls = corridor(np.random.default_rng(0), 500)
    points = walls + np.array([x, 0, 0])
    X_TS, X_TS_guess = pose(x, 0.0, 0.0), pose(x, 0.0, 0.0) @ pose(*change[3:], *change[:3])
    _, motions = constraint(points, np.where(np.abs(walls) == 1.2, 1.0, 0.0))
    along_x = undo_unheld_motion(X_TS, X_TS_guess, points, motions, np.arange(6) > 0)
    # To first order: the points come to lie where they did, but as far along x as they did in the guess.
    p_SP = X_TS.inverse().multiply(points.T)
    moved = along_x.multiply(p_SP) - points.T
    guessed = X_TS_guess.multiply(p_SP) - points.T
    np.testing.assert_allclose(moved[0].mean(), guessed[0].mean(), atol=0.01)
    np.testing.assert_allclose(moved[1:], 0, atol=0.01)


def test_all_held_is_the_result_and_none_held_is_the_guess():
    points = room_points(np.random.default_rng(0), 500)
    X_TS, X_TS_guess = pose(0.1, 0.2, 0.9, 0.01, 0.02, 0.03), pose(0.15, 0.1, 1.0, 0.0, 0.03, 0.02)
    _, motions = constraint(points, np.eye(3)[np.random.default_rng(0).integers(0, 3, len(points))])
    kept = undo_unheld_motion(X_TS, X_TS_guess, points, motions, np.ones(6, bool))
    assert kept.IsNearlyEqualTo(X_TS, 1e-12)
    undone = undo_unheld_motion(X_TS, X_TS_guess, points, motions, np.zeros(6, bool))
    assert undone.IsNearlyEqualTo(X_TS_guess, 1e-3)
    same = undo_unheld_motion(X_TS, X_TS, points, motions, np.zeros(6, bool))
    assert same.IsNearlyEqualTo(X_TS, 1e-9)
    assert isinstance(same, RigidTransform)
