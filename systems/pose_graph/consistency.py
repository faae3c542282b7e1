"""Do two loops agree? The cycle over both and the odometry between their ends, against its covariance.

Loop a joins poses i and j, loop b joins k and m near them. The cycle E = Z_a⁻¹ O_ik Z_b O_mj, with the odometry O, is
the identity up to noise: ξ = Log(E), and ξᵀ S⁻¹ ξ is chi-square distributed with 6 degrees of freedom (3 in a plane),
S being the sum of the four covariances brought to frame j (Mangelson et al., Pairwise consistent measurement set
maximization, ICRA 2018, Eq. 6). Nothing is linearised about a wrong pose: only the odometry between the ends counts,
and of loops that are near each other that is a few steps, however far the robot has drifted in between.
"""

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from .cycle_kernels import cycle_errors, detour_errors, edges_before
from .graph import ATTITUDE, PLANAR, PoseGraph, chain
from .rigid import adjoint, inverse


def path_covariances(poses: np.ndarray, step_covariance: np.ndarray) -> np.ndarray:
    """Covariance C_k of the pose k after all steps to it, of turns and shifts about and along W's axes, (N, 6, 6).

    That of the way from a to b is C_b − C_a, since step k adds Ad(X_Wk) Σ_k Ad(X_Wk)ᵀ whatever came before.

    Args:
        poses: X_Wk at the end of every step and at the start of the first, (N, 4, 4).
        step_covariance: Σ_k of the step from k − 1 to k, in k, (N − 1, 6, 6).
    """
    Ad = adjoint(poses[1:])
    result = np.zeros((len(poses), 6, 6))
    np.cumsum(Ad @ step_covariance @ np.swapaxes(Ad, -1, -2), axis=0, out=result[1:])
    return result


class LoopPairs:
    """The loops of a graph, all turned to go forward, and the ways between their ends.

    Attributes:
        ends: first and second pose of every loop, the first before the second, (L, 2).
        Z: measured pose of the second in the first, (L, 4, 4).
        covariance: of it, in the second, (L, 6, 6).
        used: of [roll, pitch, yaw, x, y, z], what the graph has.
    """

    def __init__(self, graph: PoseGraph, poses: np.ndarray):
        """
        Args:
            poses: dead reckoning, (N, 4, 4).
        """
        loops = graph.loops
        i, j = graph.i[loops], graph.j[loops]
        Z, covariance = graph.X_ij[loops].copy(), graph.covariance[loops].copy()
        back = i > j
        # (Z Exp(ξ))⁻¹ = Z⁻¹ Exp(−Ad(Z) ξ).
        Ad = adjoint(Z[back])
        covariance[back] = Ad @ covariance[back] @ np.swapaxes(Ad, -1, -2)
        Z[back] = inverse(Z[back])
        self.ends = np.stack([np.minimum(i, j), np.maximum(i, j)], axis=1)
        self.Z, self.covariance = np.ascontiguousarray(Z), np.ascontiguousarray(covariance)
        self._graph = graph
        self._poses = np.ascontiguousarray(poses)
        self._path = path_covariances(poses, graph.covariance[chain(graph)])
        self.used = PLANAR if graph.planar else np.arange(6)

    def neighbours(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Pairs of loops with the fewest steps between their ends, `count` for each, each pair once: a < b, (P,)."""
        total = len(self.ends)
        if total < 2:
            return np.zeros(0, np.int64), np.zeros(0, np.int64)
        _, near = cKDTree(self.ends).query(self.ends, k=min(count + 1, total), p=1)
        a = np.repeat(np.arange(total), near.shape[1])
        pairs = np.sort(np.stack([a, near.ravel()], axis=1), axis=1)
        pairs = np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0)
        return np.ascontiguousarray(pairs[:, 0]), np.ascontiguousarray(pairs[:, 1])

    def cycle_errors(self, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """ξᵀ S⁻¹ ξ of the cycle over loops a and b, and log det S, (P,) each."""
        both = cycle_errors(a, b, self.ends, self.Z, self.covariance, self._poses, self._path, self.used)
        return both[:, 0], both[:, 1]

    def detour_errors(self, which: np.ndarray, poses: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far loops are from `poses`, against the uncertainty of the best way round over edges that are trusted.

        One way bounds the covariance of the pose of j in i from above: every other edge can only lower it.

        Args:
            which: loops to be tested, (K,).
            poses: the best known ones, (N, 4, 4).
            edges: indices of the trusted edges of the graph.

        Returns:
            ξᵀ S⁻¹ ξ with ξ = Log(Z⁻¹ X_Wi⁻¹ X_Wj), and log det S, (K,) each; infinite where there is no way.
        """
        starts, row = np.unique(self.ends[which, 0], return_inverse=True)
        graph, kept = self._graph, edges[self._graph.kind[edges] != ATTITUDE]
        i, j, covariance = graph.i[kept], graph.j[kept], graph.covariance[kept]
        turn, shift = self.used[self.used < 3], self.used[self.used >= 3]
        # A turn moves what comes after it by its distance: some ten steps.
        lever = 10 * np.median(np.linalg.norm(graph.X_ij[kept][:, :3, 3], axis=1))
        cost = covariance[:, turn, turn].sum(axis=1) * lever**2 + covariance[:, shift, shift].sum(axis=1)
        chosen = _best_edges(i, j, cost)
        size = (len(poses), len(poses))
        weights = csr_matrix((cost[chosen], (i[chosen], j[chosen])), shape=size)
        _, before = dijkstra(weights, directed=False, indices=starts, return_predecessors=True)
        names = csr_matrix((chosen + 1, (i[chosen], j[chosen])), shape=size)
        names = (names + names.T).tocsr()
        edge_of = edges_before(before, names.indptr, names.indices, names.data.astype(np.int64))
        both = detour_errors(
            which, self.ends, self.Z, self.covariance, np.ascontiguousarray(poses), row, before, edge_of,
            np.ascontiguousarray(j), np.ascontiguousarray(covariance), self.used,
        )  # fmt: skip
        return both[:, 0], both[:, 1]


def position_deviations(graph: PoseGraph, edges: np.ndarray) -> np.ndarray:
    """Standard deviation of the position of the last pose, seen from each, by the way that leaves the least, (N,) [m].

    Args:
        edges: indices of the edges that may be used.

    Returns:
        Root of the trace of its covariance, from above; infinite where there is no way.
    """
    kept = edges[graph.kind[edges] != ATTITUDE]
    # What an edge adds at the last pose is the same whichever way goes over it: the least sum is a shortest way.
    Ad = adjoint(inverse(graph.poses[-1]) @ graph.poses[graph.j[kept]])
    moved = Ad[:, 3:] @ graph.covariance[kept] @ np.swapaxes(Ad[:, 3:], 1, 2)
    cost = np.trace(moved, axis1=1, axis2=2)
    chosen = _best_edges(graph.i[kept], graph.j[kept], cost)
    count = len(graph.poses)
    weights = csr_matrix((cost[chosen], (graph.i[kept][chosen], graph.j[kept][chosen])), shape=(count, count))
    return np.sqrt(dijkstra(weights, directed=False, indices=count - 1))


def _best_edges(i: np.ndarray, j: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """Of several edges between two poses the cheapest, indices: a sparse matrix would add them."""
    order = np.lexsort([cost, np.maximum(i, j), np.minimum(i, j)])
    low, high = np.minimum(i, j)[order], np.maximum(i, j)[order]
    first = np.ones(len(order), bool)
    first[1:] = (np.diff(low) != 0) | (np.diff(high) != 0)
    return order[first]
