"""Which loops are believed, and the statistics that it rests on."""

import numpy as np
import pytest
from naraha.systems.errors import ConfigError
from naraha.systems.pose_graph import (
    ODOMETRY,
    PoseGraph,
    RobustLoopsConfig,
    chi_squared,
    dead_reckoning,
    decide_loops,
    optimize,
    read_g2o,
)
from naraha.systems.pose_graph.consistency import LoopPairs, position_deviations
from naraha.systems.pose_graph.rigid import exponential

from tests.pose_graph.false_loops import KINDS, drifting_sphere, laps, replace_loops


def pairs_of(seed, planar=False):
    graph, _ = laps(seed, planar=planar)
    return graph, LoopPairs(graph, dead_reckoning(graph))


@pytest.mark.parametrize(("planar", "freedom"), [(False, 6), (True, 3)])
def test_errors_of_cycles_and_of_detours_are_chi_square_distributed(planar, freedom):
    cycles, detours = [], []
    for seed in range(12):
        graph, pairs = pairs_of(seed, planar)
        a, b = pairs.neighbours(6)
        cycles.append(pairs.cycle_errors(a, b)[0])
        steps = np.flatnonzero(graph.kind == ODOMETRY)
        detours.append(pairs.detour_errors(np.arange(0, 120, 20), dead_reckoning(graph), steps)[0])
    assert np.mean(np.concatenate(cycles)) == pytest.approx(freedom, rel=0.1)
    assert np.mean(np.concatenate(detours)) == pytest.approx(freedom, rel=0.35)
    assert np.percentile(np.concatenate(cycles), 50) == pytest.approx({6: 5.35, 3: 2.37}[freedom], rel=0.15)


def test_a_loop_that_is_turned_round_says_the_same():
    graph, pairs = pairs_of(3)
    e = graph.loops[5]
    i, j, X_ij, information = graph.i.copy(), graph.j.copy(), graph.X_ij.copy(), graph.information.copy()
    i[e], j[e], X_ij[e] = j[e], i[e], np.linalg.inv(X_ij[e])
    information[e] = np.linalg.inv(pairs_covariance := _turned(graph.covariance[e], graph.X_ij[e]))
    assert not np.allclose(pairs_covariance, graph.covariance[e])
    turned = PoseGraph(graph.poses, i, j, X_ij, information, graph.kind)
    a, b = pairs.neighbours(6)
    np.testing.assert_allclose(LoopPairs(turned, graph.poses).cycle_errors(a, b), pairs.cycle_errors(a, b), rtol=1e-6)


def _turned(covariance, X):
    from naraha.systems.pose_graph.rigid import adjoint

    return adjoint(X) @ covariance @ adjoint(X).T


def test_a_detour_uses_the_loops_that_are_trusted():
    graph, pairs = pairs_of(0)
    which = np.array([10])
    by_steps = pairs.detour_errors(which, graph.poses, np.flatnonzero(graph.kind == ODOMETRY))[1]
    others = np.delete(np.arange(len(graph.i)), graph.loops[10])
    by_all = pairs.detour_errors(which, graph.poses, others)[1]
    assert by_all[0] < by_steps[0] - 5
    nothing = pairs.detour_errors(which, graph.poses, graph.loops[:1])
    assert np.isinf(nothing).all()


def test_the_deviation_of_a_position_grows_with_the_way_and_shrinks_by_a_loop():
    """On a straight line of n steps: n σ² in each of three axes, and the turns of each step times its distance."""
    steps, sigma, turn = 9, 0.1, 0.02
    X = np.eye(4)
    X[0, 3] = 1.0
    poses = np.array([np.linalg.matrix_power(X, k) for k in range(steps + 1)])
    information = np.tile(np.diag(np.repeat([turn**-2.0, sigma**-2.0], 3)), (steps, 1, 1))
    line = PoseGraph(
        poses, np.arange(steps), np.arange(1, steps + 1), np.tile(X, (steps, 1, 1)), information, np.zeros(steps)
    )
    found = position_deviations(line, np.arange(steps))
    # A turn at distance d from the end moves it by d across two axes.
    expected = [
        sum(3 * sigma**2 + 2 * (turn * (steps - 1 - m)) ** 2 for m in range(k, steps)) ** 0.5 for k in range(steps + 1)
    ]
    np.testing.assert_allclose(found, expected, atol=1e-12)
    graph, _ = laps(0)
    alone = position_deviations(graph, np.flatnonzero(graph.kind == ODOMETRY))
    assert position_deviations(graph, np.arange(len(graph.i)))[0] < 0.5 * alone[0]


@pytest.mark.parametrize("planar", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_false_loops_are_refused_and_true_ones_kept(kind, planar):
    clean, _ = laps(4, planar=planar)
    optimum = optimize(clean)
    graph, false = replace_loops(clean.with_poses(optimum.poses), kind, 7)
    assert false.sum() == 24
    found = decide_loops(graph)
    kept = found.accepted[graph.loops]
    assert not (kept & false).any()
    assert (kept & ~false).sum() >= 0.98 * (~false).sum()
    assert np.array_equal(kept, np.array(found.reasons) == "accepted")
    true = np.ones(len(graph.i), bool)
    true[graph.loops[false]] = False
    assert found.chi_squared[true].sum() <= 1.01 * optimize(graph, edges=true).chi_squared[true].sum()


def test_noise_smaller_than_stated_makes_gates_narrower():
    graph, _ = laps(2)
    modest = PoseGraph(graph.poses, graph.i, graph.j, graph.X_ij, graph.information / 100, graph.kind)
    assert decide_loops(modest).noise_scale == pytest.approx(0.01, rel=0.3)
    assert decide_loops(graph).noise_scale == pytest.approx(1.0, rel=0.3)
    # An offset of 0.4 m is within the noise that is stated, ten times the real one, but not within the real one.
    X_ij = modest.X_ij.copy()
    X_ij[modest.loops[30]] = X_ij[modest.loops[30]] @ exponential(np.array([[0, 0, 0, 0.4, 0.4, 0.4]]))[0]
    off = PoseGraph(graph.poses, graph.i, graph.j, X_ij, modest.information, graph.kind)
    assert chi_squared(off, optimize(modest).poses)[modest.loops[30]] < 22
    assert not decide_loops(off).accepted[modest.loops[30]]


def test_a_single_loop_is_believed_when_the_odometry_can_tell_it_from_a_false_one():
    graph, truth = laps(5, count=2)
    one = np.concatenate([np.flatnonzero(graph.kind == ODOMETRY), graph.loops[-1:]])
    single = graph.with_edges(one)
    found = decide_loops(single)
    assert found.reasons == ("accepted",)
    gaps = [np.linalg.norm((np.linalg.inv(X[59]) @ X[119])[:3, 3]) for X in (graph.poses, found.poses, truth)]
    assert gaps[2] < 1e-9
    assert gaps[0] > 0.5
    assert gaps[1] < 0.1
    X_ij = single.X_ij.copy()
    X_ij[-1, :3, 3] += [0.0, 6.0, 0.0]
    wrong = decide_loops(PoseGraph(single.poses, single.i, single.j, X_ij, single.information, single.kind))
    assert "off by chi2" in wrong.reasons[0]
    # Odometry that knows nothing leaves it open.
    information = single.information.copy()
    information[:-1] /= 1e4
    vague = decide_loops(PoseGraph(single.poses, single.i, single.j, single.X_ij, information, single.kind))
    assert "too uncertain" in vague.reasons[0]


def test_a_loop_that_was_believed_is_refused_when_others_say_so():
    graph, _ = laps(6)
    X_ij = graph.X_ij.copy()
    X_ij[graph.loops[40], :3, 3] += [0.0, 4.0, 0.0]
    wrong = PoseGraph(graph.poses, graph.i, graph.j, X_ij, graph.information, graph.kind)
    believed = np.zeros(len(graph.i), bool)
    believed[graph.loops[40]] = True
    found = decide_loops(wrong, believed=believed)
    assert not found.accepted[graph.loops[40]]
    assert found.accepted.sum() == len(graph.i) - 1


def test_a_graph_without_loops_is_its_odometry():
    graph, _ = laps(1, count=1, steps=20)
    found = decide_loops(graph)
    assert found.reasons == ()
    np.testing.assert_allclose(found.poses, graph.poses, atol=1e-6)
    with pytest.raises(ConfigError, match="confidence: out of range"):
        decide_loops(graph, RobustLoopsConfig(confidence=1.5))


@pytest.mark.parametrize(("name", "kind"), [("sphere2500", "groups"), ("input_M3500_g2o", "values")])
def test_published_graphs_with_a_fifth_of_false_loops(shared_data, name, kind):
    clean = read_g2o(shared_data / "g2o" / f"{name}.g2o")
    graph, false = replace_loops(clean.with_poses(optimize(clean).poses), kind, 3)
    found = decide_loops(graph)
    kept = found.accepted[graph.loops]
    assert not (kept & false).any()
    assert (kept & ~false).sum() >= 0.98 * (~false).sum()


def test_loops_are_told_apart_though_dead_reckoning_has_drifted_far():
    truth = drifting_sphere(rings=16)
    clean = truth.with_poses(optimize(truth).poses)
    assert np.linalg.norm(dead_reckoning(truth)[:, :3, 3] - truth.poses[:, :3, 3], axis=1).max() > 15
    graph, false = replace_loops(clean, "groups", 1)
    found = decide_loops(graph)
    kept = found.accepted[graph.loops]
    assert not (kept & false).any()
    assert (kept & ~false).sum() >= 0.98 * (~false).sum()
