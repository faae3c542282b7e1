"""Compiled parts of matching a scan to a map: fitness, Levenberg-Marquardt, and what the scan tells.

Poses are X_MB (x, y, heading); points are p_BP, where beams ended, (n, 2) [m]. A field comes as its cells `signed`
[cells], the corner (ox, oy) of cell (0, 0) [m], the length `res` of a cell [m] and its `reach` [cells].
"""

import math

import numpy as np
from numba import njit

from .grid_kernels import look_up
from .planar import difference, wrap


@njit(cache=True)
def likelihood_fitness(
    signed: np.ndarray, ox: float, oy: float, res: float, reach: float, points: np.ndarray, X: np.ndarray, sigma: float
) -> float:
    """Mean over the beams of exp(-d² / (2 σ²)), d the distance of the beam's end from the map's surface; in [0, 1].

    A beam that comes from behind the surface meets another one, which the map may not have yet: the far side of a box.
    """
    c, s = math.cos(X[2]), math.sin(X[2])
    total, scale = 0.0, 0.5 * (res / sigma) ** 2
    for k in range(len(points)):
        px, py = c * points[k, 0] - s * points[k, 1], s * points[k, 0] + c * points[k, 1]
        d, gx, gy = look_up(signed, (X[0] + px - ox) / res, (X[1] + py - oy) / res, reach)
        if abs(d) < reach and gx * px + gy * py <= 0.0:
            total += math.exp(-d * d * scale)
    return total / max(len(points), 1)


@njit(cache=True)
def find_patches(points: np.ndarray, length: float) -> np.ndarray:
    """Number of the patch of every point, (n,): points one after the other within `length` of the patch's first."""
    patch = np.empty(len(points), np.int64)
    first, current = 0, 0
    for k in range(len(points)):
        dx, dy = points[k, 0] - points[first, 0], points[k, 1] - points[first, 1]
        if dx * dx + dy * dy > length * length:
            first, current = k, current + 1
        patch[k] = current
    return patch


@njit(cache=True)
def normal_equations(
    signed: np.ndarray,
    ox: float,
    oy: float,
    res: float,
    reach: float,
    points: np.ndarray,
    patch: np.ndarray,
    X: np.ndarray,
    noise: float,
    shared: float,
    robust: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float, int]:
    """Information A, slope g and squared error of a scan at X, and the information T that it would have along walls.

    The error of beam k is r_k = d(X p_k) = independent noise (deviation `noise`) + what all beams on a patch share
    (`shared`: the map is off there): Σ = noise² W⁻¹ + shared² 1 1ᵀ a patch, its inverse by Sherman and Morrison. W are
    the weights 1 / (1 + (r / robust)²)² of Geman and McClure. Beams from behind a surface have no say, as in
    `likelihood_fitness`. T is what A would be if every normal were turned by 90°.

    Returns:
        A = Jᵀ Σ⁻¹ J (3, 3), T (3, 3), g = Jᵀ Σ⁻¹ r (3,), robust sum of squares over noise², number of beams used.
    """
    c, s = math.cos(X[2]), math.sin(X[2])
    A, T, g = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    cost, used = 0.0, 0
    sum_w, sum_wr = 0.0, 0.0
    sum_wj, sum_wt = np.zeros(3), np.zeros(3)
    j, t = np.empty(3), np.empty(3)
    count = len(points)
    for k in range(count + 1):
        if k == count or (k > 0 and patch[k] != patch[k - 1]):
            if sum_w > 0.0:
                share = shared**2 / (noise**2 + shared**2 * sum_w)
                for a in range(3):
                    g[a] -= share * sum_wj[a] * sum_wr
                    for b in range(3):
                        A[a, b] -= share * sum_wj[a] * sum_wj[b]
                        T[a, b] -= share * sum_wt[a] * sum_wt[b]
                cost -= share * sum_wr * sum_wr
            sum_w, sum_wr = 0.0, 0.0
            sum_wj[:], sum_wt[:] = 0.0, 0.0
            if k == count:
                break
        px, py = c * points[k, 0] - s * points[k, 1], s * points[k, 0] + c * points[k, 1]
        d, gx, gy = look_up(signed, (X[0] + px - ox) / res, (X[1] + py - oy) / res, reach)
        if abs(d) > 0.95 * reach or gx * px + gy * py > 0.0:
            cost += robust**2
            continue
        r = d * res
        w = 1.0 / (1.0 + (r / robust) ** 2) ** 2
        j[0], j[1], j[2] = gx, gy, gy * px - gx * py
        t[0], t[1], t[2] = -gy, gx, gx * px + gy * py
        used += 1
        cost += r * r / (1.0 + (r / robust) ** 2)
        sum_w += w
        sum_wr += w * r
        for a in range(3):
            sum_wj[a] += w * j[a]
            sum_wt[a] += w * t[a]
            g[a] += w * j[a] * r
            for b in range(3):
                A[a, b] += w * j[a] * j[b]
                T[a, b] += w * t[a] * t[b]
    inverse = 1.0 / noise**2
    return A * inverse, T * inverse, g * inverse, cost * inverse, used


@njit(cache=True)
def refine(
    signed: np.ndarray,
    ox: float,
    oy: float,
    res: float,
    reach: float,
    points: np.ndarray,
    patch: np.ndarray,
    start: np.ndarray,
    prior: np.ndarray,
    information: np.ndarray,
    noise: float,
    shared: float,
    robust: float,
    most: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Levenberg-Marquardt on the field from `start`, with a prior of information (3, 3).

    Returns:
        The pose, A and T of the scan alone there (see `normal_equations`), and the number of beams used.
    """
    X = start.copy()
    A, T, g, cost, used = normal_equations(signed, ox, oy, res, reach, points, patch, X, noise, shared, robust)
    e = difference(prior, X)
    total = cost + e @ information @ e
    damping = 1e-3
    for _ in range(most):
        H = A + information
        for a in range(3):
            H[a, a] += damping * H[a, a] + 1e-9
        step = -np.linalg.solve(H, g + information @ e)
        tried = X + step
        tried[2] = wrap(tried[2])
        A1, T1, g1, cost1, used1 = normal_equations(
            signed, ox, oy, res, reach, points, patch, tried, noise, shared, robust
        )
        e1 = difference(prior, tried)
        total1 = cost1 + e1 @ information @ e1
        if total1 <= total:
            X, A, T, g, e, used = tried, A1, T1, g1, e1, used1
            done = total - total1 < 1e-4 * total
            total = total1
            damping = max(damping * 0.2, 1e-6)
            if done or (abs(step[0]) + abs(step[1]) < 1e-5 and abs(step[2]) < 1e-5):
                break
        else:
            damping *= 8.0
            if damping > 1e4:
                break
    return X, A, T, used
