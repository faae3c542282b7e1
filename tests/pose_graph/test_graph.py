"""Rigid motions by the array, the data of a graph, and its optimum where that is known on paper."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.pose_graph import (
    ATTITUDE,
    LOOP,
    ODOMETRY,
    PoseGraph,
    PoseGraphError,
    chi_squared,
    dead_reckoning,
    optimize,
    residuals,
)
from naraha.systems.pose_graph.rigid import adjoint, exponential, inverse, logarithm
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from tests.pose_graph.false_loops import laps

twists = st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6).map(np.array)


def shift(x, y=0.0, z=0.0, yaw=0.0):
    X = np.eye(4)
    X[:3, :3] = Rotation.from_rotvec([0, 0, yaw]).as_matrix()
    X[:3, 3] = x, y, z
    return X


def graph_of(poses, edges, planar=False):
    """`edges` of (i, j, X_ij, kind), all with unit information."""
    i, j, X_ij, kind = zip(*edges, strict=True)
    information = np.tile(np.eye(6), (len(i), 1, 1))
    return PoseGraph(np.array(poses), np.array(i), np.array(j), np.array(X_ij), information, np.array(kind), planar)


@given(twists)
def test_the_exponential_is_that_of_the_matrix_and_the_logarithm_undoes_it(xi):
    x, y, z, u, v, w = xi
    X = exponential(xi[None])[0]
    np.testing.assert_allclose(
        X, expm(np.array([[0, -z, y, u], [z, 0, -x, v], [-y, x, 0, w], [0, 0, 0, 0]])), atol=1e-9
    )
    np.testing.assert_allclose(logarithm(X[None])[0], xi, atol=1e-7)


@given(twists, twists)
def test_the_adjoint_takes_a_small_motion_to_the_other_side(a, b):
    X, xi = exponential(a[None]), b[None]
    np.testing.assert_allclose(X @ exponential(xi) @ inverse(X), exponential(xi @ adjoint(X[0]).T), atol=1e-9)


@pytest.mark.parametrize("planar", [False, True])
def test_a_contradiction_is_shared_by_equal_edges(planar):
    """Four steps of 1.1 m, and a loop that says 4.0 m: each of five equal edges takes a fifth of the 0.4 m."""
    steps = [(k, k + 1, shift(1.1), ODOMETRY) for k in range(4)]
    graph = graph_of([shift(1.1 * k) for k in range(5)], [*steps, (0, 4, shift(4.0), LOOP)], planar)
    found = optimize(graph)
    np.testing.assert_allclose(found.poses[:, :3, 3], [[1.02 * k, 0, 0] for k in range(5)], atol=1e-6)
    np.testing.assert_allclose(found.chi_squared, 0.08**2, rtol=1e-4)


@pytest.mark.parametrize("planar", [False, True])
def test_a_square_that_closes_is_left_as_it_is(planar):
    steps = [(k, k + 1, shift(2.0, yaw=np.pi / 2), ODOMETRY) for k in range(4)]
    graph = graph_of([np.eye(4)] * 5, [*steps, (0, 4, np.eye(4), LOOP)], planar)
    found = optimize(graph)
    assert found.chi_squared.sum() < 1e-10
    np.testing.assert_allclose(found.poses[2, :3, 3], [2.0, 2.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(dead_reckoning(graph)[4], np.eye(4), atol=1e-12)


def test_the_optimum_has_no_smaller_neighbour():
    graph, _ = laps(0, steps=12)
    found = optimize(graph)
    rng = np.random.default_rng(0)
    for _ in range(20):
        change = 1e-3 * rng.standard_normal((len(found.poses), 6))
        change[0] = 0
        assert chi_squared(graph, found.poses @ exponential(change)).sum() > found.chi_squared.sum()


def test_errors_are_seen_from_the_second_pose():
    xi = np.array([0.1, -0.2, 0.3, 0.4, 0.5, -0.6])
    X = shift(1.0, 2.0, 3.0, 0.5)
    graph = graph_of([np.eye(4), X @ exponential(xi[None])[0]], [(0, 1, X, ODOMETRY)])
    np.testing.assert_allclose(residuals(graph)[0], xi, atol=1e-12)
    assert chi_squared(graph)[0] == pytest.approx(xi @ xi)


def test_gravity_levels_a_pose_and_leaves_its_yaw():
    """The step says no turn, gravity says 0.2 rad of roll: with equal weights they meet half way, up to sin x ≈ x."""
    tilted = np.eye(4)
    tilted[:3, :3] = Rotation.from_euler("zx", [0.7, 0.2]).as_matrix()
    level = shift(1.0, yaw=0.7)
    graph = graph_of([np.eye(4), level], [(0, 1, level, ODOMETRY), (1, 1, tilted, ATTITUDE)])
    assert chi_squared(graph)[1] == pytest.approx(np.sin(0.2) ** 2)
    found = optimize(graph)
    yaw, _, roll = Rotation.from_matrix(found.poses[1, :3, :3]).as_euler("zyx")
    assert roll == pytest.approx(0.1, abs=1e-3)
    assert yaw == pytest.approx(0.7, abs=1e-6)
    np.testing.assert_allclose(found.chi_squared, 0.01, atol=1e-4)


def test_a_graph_is_frozen_and_checked():
    graph = graph_of([np.eye(4), shift(1)], [(0, 1, shift(1), ODOMETRY)])
    with pytest.raises(ValueError, match="read-only"):
        graph.poses[0, 0, 0] = 2
    with pytest.raises(PoseGraphError, match=r"PoseGraph: j: no such pose .valid: 0 to 1"):
        graph_of([np.eye(4), shift(1)], [(0, 2, shift(1), ODOMETRY)])
    with pytest.raises(PoseGraphError, match="X_ij: wrong shape"):
        PoseGraph(graph.poses, graph.i, graph.j, np.eye(3), graph.information, graph.kind)
    with pytest.raises(PoseGraphError, match="X_ij: not finite"):
        graph_of([np.eye(4), shift(1)], [(0, 1, shift(np.nan), ODOMETRY)])
    with pytest.raises(PoseGraphError, match="edge 0: only an attitude has one end"):
        graph_of([np.eye(4)], [(0, 0, np.eye(4), LOOP)])


def test_a_pose_without_edges_and_a_gap_in_the_odometry_are_named():
    with pytest.raises(PoseGraphError, match="a pose hangs on no edge, got 1"):
        optimize(graph_of([np.eye(4)] * 3, [(0, 2, shift(2), LOOP)]))
    with pytest.raises(PoseGraphError, match="no odometry from pose 0 to 1"):
        dead_reckoning(graph_of([np.eye(4)] * 3, [(1, 2, shift(2), ODOMETRY)]))


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("sphere2500", 1351.4019),
        ("parking-garage", 1.268384),
        ("input_M3500_g2o", 137.9149),
        ("input_MITb_g2o", 41.207),  # from odometry it is 770
    ],
)
def test_published_graphs_reach_their_optimum(shared_data, name, expected):
    from naraha.systems.pose_graph import read_g2o

    found = optimize(read_g2o(shared_data / "g2o" / f"{name}.g2o"))
    assert found.chi_squared.sum() == pytest.approx(expected, rel=1e-5)
