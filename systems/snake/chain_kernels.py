"""Compiled kinematics of an alternating chain of pitch and yaw joints, with gradients in closed form.

A chain has m joints, pitch (y axis) and yaw (z axis) in turn, one half unit apart along the negative x axis of the
links between them. Its reference frame A has its origin at the first joint and the axes of the link before it. The
control frame C has its origin at the last joint and the axes of the link behind it.
"""

import numpy as np
from numba import njit


@njit(cache=True)
def forward(
    theta: np.ndarray, half_length: float, starts_with_yaw: bool, origins: np.ndarray, axes: np.ndarray, R: np.ndarray
) -> None:
    """Writes origins (m, 3) [m] and axes (m, 3) of the joints in A, and turns R (3, 3) from R_AA to R_AC."""
    x = y = z = 0.0
    for j in range(theta.shape[0]):
        c, s = np.cos(theta[j]), np.sin(theta[j])
        yaw = (j % 2 == 1) != starts_with_yaw
        origins[j, 0], origins[j, 1], origins[j, 2] = x, y, z
        for r in range(3):
            r0, r1, r2 = R[r, 0], R[r, 1], R[r, 2]
            if yaw:
                axes[j, r] = r2
                R[r, 0], R[r, 1] = c * r0 + s * r1, c * r1 - s * r0
            else:
                axes[j, r] = r1
                R[r, 0], R[r, 2] = c * r0 - s * r2, s * r0 + c * r2
        x -= half_length * R[0, 0]
        y -= half_length * R[1, 0]
        z -= half_length * R[2, 0]


@njit(cache=True)
def fill_jacobian(origins: np.ndarray, axes: np.ndarray, J: np.ndarray) -> None:
    """Writes J (6, m): velocity of the last origin [m], then angular velocity, for unit rates of the joints."""
    m = origins.shape[0]
    for j in range(m):
        dx = origins[m - 1, 0] - origins[j, 0]
        dy = origins[m - 1, 1] - origins[j, 1]
        dz = origins[m - 1, 2] - origins[j, 2]
        a, b, c = axes[j, 0], axes[j, 1], axes[j, 2]
        J[0, j], J[1, j], J[2, j] = b * dz - c * dy, c * dx - a * dz, a * dy - b * dx
        J[3, j], J[4, j], J[5, j] = a, b, c


@njit(cache=True)
def jacobian_derivative(J: np.ndarray) -> np.ndarray:
    """∂J[r, i]/∂θ_j (6, m, m): linear part a_min(i,j) × Jp_max(i,j), angular part a_j × a_i for j < i, else 0."""
    m = J.shape[1]
    dJ = np.zeros((6, m, m))
    for i in range(m):
        for j in range(m):
            near, far = min(i, j), max(i, j)
            for r in range(3):
                p, q = (r + 1) % 3, (r + 2) % 3
                dJ[r, i, j] = J[3 + p, near] * J[q, far] - J[3 + q, near] * J[p, far]
                if j < i:
                    dJ[3 + r, i, j] = J[3 + p, j] * J[3 + q, i] - J[3 + q, j] * J[3 + p, i]
    return dJ


@njit(cache=True)
def add_manipulability_gradient(J: np.ndarray, pinv: np.ndarray, factor: float, gradient: np.ndarray) -> None:
    """Adds factor · ∂ log det(J Jᵀ)/∂θ to `gradient` (m,), where pinv (m, 6) is Jᵀ(J Jᵀ)⁻¹.

    ∂ log det(J Jᵀ)/∂θ_j = 2 Σ_i b_i · ∂Jp_i/∂θ_j + c_i · ∂a_i/∂θ_j with (b_i, c_i) = pinv[i]. The triple products are
    turned so that the sums over i ≥ j and i < j no longer depend on j, and running sums give all of them in O(m).
    """
    m = J.shape[1]
    u0 = u1 = u2 = 0.0  # Σ_{i >= j} Jp_i × b_i + Σ_{i > j} a_i × c_i
    for j in range(m - 1, -1, -1):
        a0, a1, a2 = J[3, j], J[4, j], J[5, j]
        p0, p1, p2 = J[0, j], J[1, j], J[2, j]
        b0, b1, b2 = pinv[j, 0], pinv[j, 1], pinv[j, 2]
        c0, c1, c2 = pinv[j, 3], pinv[j, 4], pinv[j, 5]
        u0 += p1 * b2 - p2 * b1
        u1 += p2 * b0 - p0 * b2
        u2 += p0 * b1 - p1 * b0
        gradient[j] += 2.0 * factor * (a0 * u0 + a1 * u1 + a2 * u2)
        u0 += a1 * c2 - a2 * c1
        u1 += a2 * c0 - a0 * c2
        u2 += a0 * c1 - a1 * c0
    v0 = v1 = v2 = 0.0  # Σ_{i < j} b_i × a_i
    for j in range(m):
        gradient[j] += 2.0 * factor * (J[0, j] * v0 + J[1, j] * v1 + J[2, j] * v2)
        a0, a1, a2 = J[3, j], J[4, j], J[5, j]
        b0, b1, b2 = pinv[j, 0], pinv[j, 1], pinv[j, 2]
        v0 += b1 * a2 - b2 * a1
        v1 += b2 * a0 - b0 * a2
        v2 += b0 * a1 - b1 * a0


@njit(cache=True)
def add_distance_gradient(
    origins: np.ndarray, axes: np.ndarray, middle: int, target: np.ndarray, factor: float, gradient: np.ndarray
) -> float:
    """Adds factor · ∂d²/∂θ to `gradient`, with d the distance of joint `middle` from `target`; returns d² [m²]."""
    m0, m1, m2 = origins[middle, 0], origins[middle, 1], origins[middle, 2]
    d0, d1, d2 = m0 - target[0], m1 - target[1], m2 - target[2]
    for j in range(middle):
        x, y, z = m0 - origins[j, 0], m1 - origins[j, 1], m2 - origins[j, 2]
        # d · (a × r) = a · (r × d)
        turn = axes[j, 0] * (y * d2 - z * d1) + axes[j, 1] * (z * d0 - x * d2) + axes[j, 2] * (x * d1 - y * d0)
        gradient[j] += 2.0 * factor * turn
    return d0 * d0 + d1 * d1 + d2 * d2


@njit(cache=True)
def factor_gram(J: np.ndarray, free: np.ndarray, damping: float, L: np.ndarray) -> float:
    """Cholesky factor L (6, 6) of J_f J_fᵀ + damping² I, J_f the columns that are `free`; returns log det(L Lᵀ).

    A pivot that rounding has used up counts as 1e-300: the matrix is then singular and L useless.
    """
    m = J.shape[1]
    log_det = 0.0
    for r in range(6):
        for c in range(r + 1):
            total = damping * damping if r == c else 0.0
            for k in range(m):
                if free[k]:
                    total += J[r, k] * J[c, k]
            for k in range(c):
                total -= L[r, k] * L[c, k]
            if r == c:
                pivot = max(total, 1e-300)
                L[r, r] = np.sqrt(pivot)
                log_det += np.log(pivot)
            else:
                L[r, c] = total / L[c, c]
    return log_det


@njit(cache=True)
def solve_gram(L: np.ndarray, x: np.ndarray) -> None:
    """Solves L Lᵀ y = x in place, (6,)."""
    for r in range(6):
        for k in range(r):
            x[r] -= L[r, k] * x[k]
        x[r] /= L[r, r]
    for r in range(5, -1, -1):
        for k in range(r + 1, 6):
            x[r] -= L[k, r] * x[k]
        x[r] /= L[r, r]


@njit(cache=True)
def axle_rates(theta: np.ndarray, rates: np.ndarray, half_length: float, wheel_radius: float, out: np.ndarray) -> None:
    """Writes the rate (n,) [rad/s] with which the wheels of each unit roll when the chain moves and A stands.

    It is the speed of the axle along the link in front of it over the radius, less the rate at which that link turns
    about the axle.

    Args:
        theta, rates: (2n - 1,) angles [rad] and rates [rad/s] of a chain that begins with the pitch joint of the first
            of the n units.
    """
    R = np.eye(3)
    v, w, step, turn = np.zeros(3), np.zeros(3), np.empty(3), np.empty(3)
    for j in range(theta.shape[0]):
        c, s = np.cos(theta[j]), np.sin(theta[j])
        if j % 2 == 0:
            forward_speed = v[0] * R[0, 0] + v[1] * R[1, 0] + v[2] * R[2, 0]
            pitch_rate = w[0] * R[0, 1] + w[1] * R[1, 1] + w[2] * R[2, 1]
            out[j // 2] = forward_speed / wheel_radius - pitch_rate
        for r in range(3):
            r0, r1, r2 = R[r, 0], R[r, 1], R[r, 2]
            if j % 2 == 0:
                w[r] += rates[j] * r1
                R[r, 0], R[r, 2] = c * r0 - s * r2, s * r0 + c * r2
            else:
                w[r] += rates[j] * r2
                R[r, 0], R[r, 1] = c * r0 + s * r1, c * r1 - s * r0
            step[r] = -half_length * R[r, 0]
        turn[0] = w[1] * step[2] - w[2] * step[1]
        turn[1] = w[2] * step[0] - w[0] * step[2]
        turn[2] = w[0] * step[1] - w[1] * step[0]
        for r in range(3):
            v[r] += turn[r]
