"""A start for planar graphs that needs no guess: rotations first, as complex numbers, then positions."""

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.linalg import spsolve

from .graph import PoseGraph


def planar_chordal(graph: PoseGraph, edges: np.ndarray) -> np.ndarray:
    """Poses of a planar graph from two linear least-squares problems, (N, 4, 4); the first pose is held.

    The heading of pose k is the unit complex number z_k. Σ ω |z_j − z_i e^{iθ}|² has its minimum at the solution of one
    linear system when |z_k| = 1 is left out, and with the z_k scaled back to it, the positions are that of another
    (Carlone et al., Initialization techniques for 3D SLAM, ICRA 2015, section III.C, in two dimensions). gtsam's own
    start for planar graphs, LAGO, rounds turns to multiples of 2π one by one and ends in a local minimum on MITb.

    Args:
        edges: indices of those that count.
    """
    count, rows = len(graph.poses), np.arange(len(edges))
    i, j, X = graph.i[edges], graph.j[edges], graph.X_ij[edges]
    weight = np.sqrt(graph.information[edges, 2, 2])
    turn = X[:, 0, 0] + 1j * X[:, 1, 0]
    A = csr_matrix(
        (np.concatenate([weight + 0j, -weight * turn]), (np.tile(rows, 2), np.concatenate([j, i]))),
        shape=(len(edges), count),
    ).tocsc()
    z0 = np.array([graph.poses[0, 0, 0] + 1j * graph.poses[0, 1, 0]])
    z = _solve(A, z0, np.zeros(len(edges)))
    z /= np.maximum(np.abs(z), 1e-12)

    # Lᵀ (R_iᵀ (p_j − p_i) − p_ij) with Ω = L Lᵀ.
    L_transposed = np.swapaxes(np.linalg.cholesky(graph.information[edges, 3:5, 3:5]), 1, 2)
    R_transposed = np.empty((len(edges), 2, 2))
    R_transposed[:, 0, 0] = R_transposed[:, 1, 1] = z[i].real
    R_transposed[:, 0, 1], R_transposed[:, 1, 0] = z[i].imag, -z[i].imag
    block = L_transposed @ R_transposed
    row, column = np.broadcast_arrays(2 * rows[:, None, None] + np.arange(2)[:, None], np.arange(2))
    columns = np.concatenate([(2 * end[:, None, None] + column).ravel() for end in (j, i)])
    values = np.concatenate([block.ravel(), -block.ravel()])
    B = coo_matrix((values, (np.tile(row.ravel(), 2), columns)), shape=(2 * len(edges), 2 * count)).tocsc()
    shifts = np.einsum("nij,nj->ni", L_transposed, X[:, :2, 3]).ravel()
    p = _solve(B, graph.poses[0, :2, 3], shifts).reshape(-1, 2)

    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 0] = poses[:, 1, 1] = z.real
    poses[:, 1, 0], poses[:, 0, 1] = z.imag, -z.imag
    poses[:, :2, 3] = p
    return poses


def _solve(A: csr_matrix, first: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Least squares A x = b with the first entries of x given; all of x."""
    known = A[:, : len(first)] @ first
    rest = A[:, len(first) :]
    adjoint = rest.conj().T
    return np.concatenate([first, np.atleast_1d(spsolve((adjoint @ rest).tocsc(), adjoint @ (b - known)))])
