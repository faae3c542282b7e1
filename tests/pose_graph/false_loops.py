"""Pose graphs with false loops, for tests and the benchmark."""

from dataclasses import replace

import numpy as np
from naraha.systems.pose_graph import LOOP, ODOMETRY, PoseGraph, dead_reckoning
from naraha.systems.pose_graph.rigid import exponential, inverse
from scipy.spatial.transform import Rotation

KINDS = ("values", "ends", "groups")
# A loop that is off by less than both is not called false [m], [rad].
FALSE_DISTANCE, FALSE_ANGLE = 3.0, 0.5


def replace_loops(
    graph: PoseGraph, kind: str, seed: int, share: float = 0.2, values_within: float = 20.0
) -> tuple[PoseGraph, np.ndarray]:
    """The graph with a share of its loops replaced by false ones, and which of its loops are false, (L,) bool.

    Args:
        graph: its poses are the optimum: they say what is false.
        kind: "values" keeps the ends and puts any rotation and a position within `values_within` [m] between them;
            "ends" puts what one loop says between two other poses; "groups" does so, and lets two or three such loops
            agree with each other over the odometry, as two places that look alike would.
    """
    rng = np.random.default_rng(seed)
    i, j, X_ij = graph.i.copy(), graph.j.copy(), graph.X_ij.copy()
    chosen = np.sort(rng.choice(graph.loops, int(share * len(graph.loops)), replace=False))
    chain, left = dead_reckoning(graph), list(chosen)
    while left:
        size = min(int(rng.integers(2, 4)), len(left)) if kind == "groups" else 1
        if kind == "values":
            first, second, measured = i[left[0]], j[left[0]], _any_pose(rng, values_within, graph.planar)
        else:
            first, second = np.sort(rng.integers(0, len(graph.poses) - 3, 2))
            measured = graph.X_ij[rng.choice(graph.loops)]
            if second - first < 8:
                continue
        error = inverse(measured) @ inverse(graph.poses[first]) @ graph.poses[second]
        angle = np.linalg.norm(Rotation.from_matrix(error[:3, :3]).as_rotvec())
        if np.linalg.norm(error[:3, 3]) < FALSE_DISTANCE and angle < FALSE_ANGLE:
            continue
        for q in range(size):
            e = left.pop(0)
            i[e], j[e] = first + q, second + q
            before, after = inverse(chain[first + q]) @ chain[first], inverse(chain[second]) @ chain[second + q]
            X_ij[e] = before @ measured @ after
    return replace(graph, i=i, j=j, X_ij=X_ij), np.isin(graph.loops, chosen)


def _any_pose(rng: np.random.Generator, within: float, planar: bool) -> np.ndarray:
    X = np.eye(4)
    turn, shift = rng.normal(size=3), rng.uniform(-within, within, 3)
    if planar:
        turn[:2] = shift[2] = 0
    X[:3, :3] = Rotation.from_rotvec(rng.uniform(-np.pi, np.pi) * turn / np.linalg.norm(turn)).as_matrix()
    X[:3, 3] = shift
    return X


def laps(seed: int, *, steps: int = 60, count: int = 3, planar: bool = False) -> tuple[PoseGraph, np.ndarray]:
    """A robot that goes round in a circle of radius 10 m `count` times, and sees each place again; and its true poses.

    Noise of all edges: 0.03 m and 0.01 rad; the poses of the graph are dead reckoning.
    """
    rng = np.random.default_rng(seed)
    total = steps * count
    angle = 2 * np.pi * np.arange(total) / steps
    truth = np.tile(np.eye(4), (total, 1, 1))
    truth[:, :3, :3] = Rotation.from_rotvec(np.outer(angle, [0, 0, 1])).as_matrix()
    truth[:, 0, 3], truth[:, 1, 3] = 10 * np.sin(angle), 10 - 10 * np.cos(angle)
    i = np.concatenate([np.arange(total - 1), np.arange(total - steps)])
    j = np.concatenate([np.arange(1, total), np.arange(steps, total)])
    sigma = np.repeat([0.01, 0.03], 3)
    noise = sigma * rng.standard_normal((len(i), 6))
    if planar:
        noise[:, [0, 1, 5]] = 0
    X_ij = inverse(truth[i]) @ truth[j] @ exponential(noise)
    kind = np.where(j - i == 1, ODOMETRY, LOOP)
    information = np.tile(np.diag(sigma**-2.0), (len(i), 1, 1))
    graph = PoseGraph(truth, i, j, X_ij, information, kind, planar)
    return graph.with_poses(dead_reckoning(graph)), truth


def drifting_sphere(seed: int = 0, rings: int = 50, each: int = 50) -> PoseGraph:
    """A spiral of `rings` turns over a sphere of radius 50 m, every pose seen again a turn later; no published file.

    Noise of 0.05 m and 0.02 rad is as stated, and dead reckoning ends a hundred metres off. The poses are the truth.
    """
    rng = np.random.default_rng(seed)
    count = rings * each
    k = np.arange(count)
    latitude, longitude = np.pi * ((k + each / 2) / (count + each) - 0.5), 2 * np.pi * k / each
    up = np.stack([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)], 1)
    east = np.stack([-np.sin(longitude), np.cos(longitude), 0 * k], 1)
    truth = np.tile(np.eye(4), (count, 1, 1))
    truth[:, :3, :3] = np.stack([east, np.cross(up, east), up], 2)
    truth[:, :3, 3] = 50 * up
    i = np.concatenate([k[:-1], k[:-each]])
    j = np.concatenate([k[1:], k[each:]])
    sigma = np.repeat([0.02, 0.05], 3)
    X_ij = inverse(truth[i]) @ truth[j] @ exponential(sigma * rng.standard_normal((len(i), 6)))
    kind = np.where(j - i == 1, ODOMETRY, LOOP)
    return PoseGraph(truth, i, j, X_ij, np.tile(np.diag(sigma**-2.0), (len(i), 1, 1)), kind)
