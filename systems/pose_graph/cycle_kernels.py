"""Compiled loops of `consistency`: errors of closed ways, each against its own covariance.

Poses are read from the first three rows of (4, 4) or (3, 4) arrays.
"""

import numpy as np
from numba import njit


@njit(cache=True)
def _adjoint(X: np.ndarray, out: np.ndarray) -> None:
    for r in range(3):
        for c in range(3):
            out[r, c] = out[r + 3, c + 3] = X[r, c]
            out[r, c + 3] = 0.0
    for c in range(3):
        out[3, c] = X[1, 3] * X[2, c] - X[2, 3] * X[1, c]
        out[4, c] = X[2, 3] * X[0, c] - X[0, 3] * X[2, c]
        out[5, c] = X[0, 3] * X[1, c] - X[1, 3] * X[0, c]


@njit(cache=True)
def _inverse(X: np.ndarray, out: np.ndarray) -> None:
    for r in range(3):
        for c in range(3):
            out[r, c] = X[c, r]
        out[r, 3] = -(X[0, r] * X[0, 3] + X[1, r] * X[1, 3] + X[2, r] * X[2, 3])


@njit(cache=True)
def _compose(A: np.ndarray, B: np.ndarray, out: np.ndarray) -> None:
    for r in range(3):
        for c in range(4):
            out[r, c] = A[r, 0] * B[0, c] + A[r, 1] * B[1, c] + A[r, 2] * B[2, c]
        out[r, 3] += A[r, 3]


@njit(cache=True)
def _add_moved(Ad: np.ndarray, covariance: np.ndarray, sign: float, S: np.ndarray) -> None:
    """S += ± Ad Σ Adᵀ."""
    half = np.zeros((6, 6))
    for r in range(6):
        for k in range(6):
            a = Ad[r, k]
            if a != 0.0:
                for c in range(6):
                    half[r, c] += a * covariance[k, c]
    for r in range(6):
        for c in range(6):
            total = 0.0
            for k in range(6):
                total += half[r, k] * Ad[c, k]
            S[r, c] += sign * total


@njit(cache=True)
def _log(X: np.ndarray, out: np.ndarray) -> None:
    x, y, z = 0.5 * (X[2, 1] - X[1, 2]), 0.5 * (X[0, 2] - X[2, 0]), 0.5 * (X[1, 0] - X[0, 1])
    sine, cosine = np.sqrt(x * x + y * y + z * z), 0.5 * (X[0, 0] + X[1, 1] + X[2, 2] - 1.0)
    angle = np.arctan2(sine, cosine)
    if sine < 1e-7 and cosine < 0:
        # Half a turn: its axis is of no interest, it is far off in any case.
        out[:] = np.pi
        return
    scale = angle / sine if sine > 1e-9 else 1.0
    x, y, z = x * scale, y * scale, z * scale
    second = 1.0 / 12.0
    if angle > 1e-4:
        second = (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / angle**2
    u, v, w = X[0, 3], X[1, 3], X[2, 3]
    a, b, c = y * w - z * v, z * u - x * w, x * v - y * u
    out[0], out[1], out[2] = x, y, z
    out[3] = u - 0.5 * a + second * (y * c - z * b)
    out[4] = v - 0.5 * b + second * (z * a - x * c)
    out[5] = w - 0.5 * c + second * (x * b - y * a)


@njit(cache=True)
def _mahalanobis(S: np.ndarray, xi: np.ndarray, used: np.ndarray, work: np.ndarray) -> tuple[float, float]:
    """ξᵀ S⁻¹ ξ and log det S of the `used` rows, by Cholesky; infinite where S is not positive definite."""
    total, log_det = 0.0, 0.0
    for r in range(len(used)):
        for c in range(r + 1):
            value = S[used[r], used[c]]
            for k in range(c):
                value -= work[r, k] * work[c, k]
            if r > c:
                work[r, c] = value / work[c, c]
            elif value <= 0:
                return np.inf, np.inf
            else:
                work[r, r] = np.sqrt(value)
                log_det += np.log(value)
        value = xi[used[r]]
        for k in range(r):
            value -= work[r, k] * work[k, 6]
        work[r, 6] = value / work[r, r]
        total += work[r, 6] ** 2
    return total, log_det


@njit(cache=True)
def cycle_errors(
    a: np.ndarray,
    b: np.ndarray,
    ends: np.ndarray,
    Z: np.ndarray,
    covariance: np.ndarray,
    poses: np.ndarray,
    path: np.ndarray,
    used: np.ndarray,
) -> np.ndarray:
    """ξᵀ S⁻¹ ξ and log det S of the cycle over loops a and b and the chain between their ends, (P, 2).

    Args:
        a, b: pairs of loops, (P,).
        ends, Z, covariance: of the loops, see `LoopPairs`.
        poses, path: of the chain, (N, 4, 4), and covariance of each since the first in W, (N, 6, 6).
        used: which rows of ξ and S count.
    """
    result = np.empty((len(a), 2))
    Ad, work = np.zeros((6, 6)), np.zeros((6, 7))
    A, B, C, D, E = np.zeros((3, 4)), np.zeros((3, 4)), np.zeros((3, 4)), np.zeros((3, 4)), np.zeros((3, 4))
    xi = np.zeros(6)
    for n in range(len(a)):
        i, j = ends[a[n], 0], ends[a[n], 1]
        k, m = ends[b[n], 0], ends[b[n], 1]
        S = covariance[a[n]].copy()
        _inverse(poses[m], A)
        _compose(A, poses[j], B)  # O_mj
        _inverse(B, A)  # O_jm: what is in m is brought to j
        _adjoint(A, Ad)
        _add_moved(Ad, covariance[b[n]], 1.0, S)
        _compose(Z[b[n]], B, C)  # Z_b O_mj: pose of j in k
        if i != k:
            _inverse(C, A)
            _inverse(poses[k], B)
            _compose(A, B, D)  # W in j, by way of k
            _adjoint(D, Ad)
            sign = 1.0 if k > i else -1.0
            _add_moved(Ad, path[k] - path[i], sign, S)
        if j != m:
            _inverse(poses[j], A)
            _adjoint(A, Ad)
            sign = 1.0 if j > m else -1.0
            _add_moved(Ad, path[j] - path[m], sign, S)
        _inverse(poses[i], A)
        _compose(A, poses[k], B)  # O_ik
        _compose(B, C, D)
        _inverse(Z[a[n]], A)
        _compose(A, D, E)
        _log(E, xi)
        result[n, 0], result[n, 1] = _mahalanobis(S, xi, used, work)
    return result


@njit(cache=True)
def detour_errors(
    which: np.ndarray,
    ends: np.ndarray,
    Z: np.ndarray,
    covariance: np.ndarray,
    poses: np.ndarray,
    row: np.ndarray,
    before: np.ndarray,
    edge_of: np.ndarray,
    edge_end: np.ndarray,
    edge_covariance: np.ndarray,
    used: np.ndarray,
) -> np.ndarray:
    """ξᵀ S⁻¹ ξ and log det S of loops against poses, with S along the best way round, (K, 2); see `LoopPairs`.

    Args:
        which: the loops, (K,).
        ends, Z, covariance: of all loops.
        poses: X_Wk, (N, 4, 4).
        row: which tree of ways each loop uses, the one from its first end, (K,).
        before, edge_of: pose before each pose on the way, and the edge between, (trees, N); negative where none is.
        edge_end, edge_covariance: second pose and covariance there of the edges.
        used: which rows of ξ and S count.
    """
    result = np.full((len(which), 2), np.inf)
    Ad, work = np.zeros((6, 6)), np.zeros((6, 7))
    A, B, C = np.zeros((3, 4)), np.zeros((3, 4)), np.zeros((3, 4))
    xi = np.zeros(6)
    for n in range(len(which)):
        i, j = ends[which[n], 0], ends[which[n], 1]
        S = covariance[which[n]].copy()
        _inverse(poses[j], A)
        at = j
        while at != i and at >= 0:
            e = edge_of[row[n], at]
            if e < 0:
                break
            _compose(A, poses[edge_end[e]], B)
            _adjoint(B, Ad)
            _add_moved(Ad, edge_covariance[e], 1.0, S)
            at = before[row[n], at]
        if at != i:
            continue  # no way from i to j
        _inverse(poses[i], B)
        _compose(B, poses[j], A)
        _inverse(Z[which[n]], B)
        _compose(B, A, C)
        _log(C, xi)
        result[n, 0], result[n, 1] = _mahalanobis(S, xi, used, work)
    return result


@njit(cache=True)
def edges_before(before: np.ndarray, indptr: np.ndarray, indices: np.ndarray, names: np.ndarray) -> np.ndarray:
    """The edge that leads from the pose before to each pose, of every start; −1 where there is none."""
    result = np.full(before.shape, -1)
    for s in range(before.shape[0]):
        for k in range(before.shape[1]):
            if before[s, k] >= 0:
                for n in range(indptr[k], indptr[k + 1]):
                    if indices[n] == before[s, k]:
                        result[s, k] = names[n] - 1
                        break
    return result
