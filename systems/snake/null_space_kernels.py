"""One compiled control tick of null-space recovery (rows S1-a and S1-b)."""

import numpy as np
from numba import njit

from .chain_kernels import add_distance_gradient, add_manipulability_gradient, factor_gram, fill_jacobian, forward
from .chain_kernels import solve_gram as _solve

# Places in the `settings` of a tick.
HALF_LENGTH, MIDDLE, K_POSITION, K_ROTATION, ALPHA = 0, 1, 2, 3, 4
TARGET_WEIGHT, SINGULAR_WEIGHT, JOINT_WEIGHT, LOG_SINGULAR, JOINT_MARGIN = 5, 6, 7, 8, 9
DAMPING, DAMPED_BELOW, MAX_NULL_RATE, MAX_RATE, LIMIT_GAIN = 10, 11, 12, 13, 14
BOUNDED, SETTINGS = 15, 16

# Places in the `report` of a tick: the error (6), then these.
DISTANCE, MANIPULABILITY, AT_BOUND, RESIDUAL, SINGULAR, REPORT = 6, 7, 8, 9, 10, 11


@njit(cache=True)
def pose_error(origin: np.ndarray, R: np.ndarray, reference: np.ndarray, error: np.ndarray) -> None:
    """Writes (p - p_ref, the rotation vector from R_ref to R) into `error` (6,) [m, rad]."""
    for r in range(3):
        error[r] = origin[r] - reference[r]
    # The lower triangle of R R_refᵀ against the upper one, and its trace.
    v0 = v1 = v2 = trace = 0.0
    for k in range(3):
        q0, q1, q2 = reference[3 + k], reference[6 + k], reference[9 + k]
        v0 += R[2, k] * q1 - R[1, k] * q2
        v1 += R[0, k] * q2 - R[2, k] * q0
        v2 += R[1, k] * q0 - R[0, k] * q1
        trace += R[0, k] * q0 + R[1, k] * q1 + R[2, k] * q2
    s = 0.5 * np.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
    scale = 0.5 if s < 1e-9 else 0.5 * np.arctan2(s, 0.5 * (trace - 1.0)) / s
    error[3], error[4], error[5] = scale * v0, scale * v1, scale * v2


@njit(cache=True)
def joint_bounds(angle: float, limit: float, gain: float, max_rate: float) -> tuple[float, float]:
    """Slowest and fastest rate [rad/s] with which a joint stays within ±limit, or goes back when it is beyond."""
    low = min(max(-gain * (limit + angle), -max_rate), max_rate)
    high = min(max(gain * (limit - angle), -max_rate), max_rate)
    return low, high


@njit(cache=True)
def cost_gradient(
    theta: np.ndarray,
    origins: np.ndarray,
    axes: np.ndarray,
    J: np.ndarray,
    L: np.ndarray,
    log_det: float,
    target: np.ndarray,
    limits: np.ndarray,
    settings: np.ndarray,
    gradient: np.ndarray,
) -> float:
    """Writes η = ∂V/∂θ of row S1-b into `gradient`; returns the distance d [m]. L factors the (damped) J Jᵀ."""
    m = theta.shape[0]
    gradient[:] = 0.0
    middle = int(settings[MIDDLE])
    squared = add_distance_gradient(origins, axes, middle, target, settings[TARGET_WEIGHT], gradient)
    weight = settings[SINGULAR_WEIGHT]
    if weight > 0.0:
        pinv = np.empty((m, 6))
        for j in range(m):
            for r in range(6):
                pinv[j, r] = J[r, j]
            _solve(L, pinv[j])
        factor = -weight if settings[LOG_SINGULAR] > 0.0 else -weight * np.exp(-log_det)
        add_manipulability_gradient(J, pinv, factor, gradient)
    weight = settings[JOINT_WEIGHT]
    if weight > 0.0:
        for j in range(m):
            beyond = abs(theta[j]) - (limits[j] - settings[JOINT_MARGIN])
            if beyond > 0.0:
                gradient[j] += np.sign(theta[j]) * weight * 3.0 * beyond * beyond / m
    return np.sqrt(squared)


@njit(cache=True)
def bounded_rates(
    J: np.ndarray,
    wanted: np.ndarray,
    task: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    damping: float,
    L: np.ndarray,
) -> tuple[np.ndarray, int, float]:
    """Rates nearest to `wanted` with J θ̇ = task and low <= θ̇ <= high, by fixing the worst joint until none is left.

    Without an active bound this is J⁺ task + (I - J⁺ J) wanted, the law of row S1-a. L factors J Jᵀ + damping² I and
    is overwritten when bounds become active.

    Returns:
        Rates (m,), how many stand at a bound, and what is missing of the task, |J θ̇ - task|.
    """
    m = J.shape[1]
    rates = wanted.copy()
    free = np.ones(m, dtype=np.bool_)
    fixed = 0
    rest = np.empty(6)
    while True:
        for r in range(6):
            rest[r] = task[r]
            for j in range(m):
                rest[r] -= J[r, j] * (wanted[j] if free[j] else rates[j])
        _solve(L, rest)
        worst, worst_by = -1, 1e-12
        for j in range(m):
            if free[j]:
                rates[j] = wanted[j]
                for r in range(6):
                    rates[j] += J[r, j] * rest[r]
                by = max(low[j] - rates[j], rates[j] - high[j])
                if by > worst_by:
                    worst, worst_by = j, by
        if worst < 0:
            break
        rates[worst] = min(max(rates[worst], low[worst]), high[worst])
        free[worst] = False
        fixed += 1
        if fixed == m:
            break
        # With fewer free joints than components of the task, damping keeps what remains finite.
        factor_gram(J, free, max(damping, 5e-3), L)
    missing = 0.0
    for r in range(6):
        total = -task[r]
        for j in range(m):
            total += J[r, j] * rates[j]
        missing += total * total
    return rates, fixed, np.sqrt(missing)


@njit(cache=True)
def recovery_tick(
    theta: np.ndarray,
    reference: np.ndarray,
    target: np.ndarray,
    limits: np.ndarray,
    settings: np.ndarray,
    report: np.ndarray,
) -> np.ndarray:
    """θ̇ = J⁺{ẇ_ref - K(w_e - w_ref)} + (I - J⁺J) α η (row S1-a), within the joints' ranges and rates if `BOUNDED`.

    Args:
        theta: (m,) angles of the segment [rad].
        reference: (18,) of the control point in A: position [m], rotation row by row, twist (v, ω) [m/s, rad/s].
        target: (3,) of the segment's middle joint in A [m].
        limits: (m,) ranges [rad], the same to both sides.
        settings: (SETTINGS,) by the places above.
        report: (REPORT,) is written: error (6), distance, manipulability √det(JJᵀ), joints at a bound, what is missing
            of the task's velocity, and 1 when the law has no solution.

    Returns:
        Joint rates (m,) [rad/s]; zero when the pose is singular and damping is zero.
    """
    m = theta.shape[0]
    length = settings[HALF_LENGTH]
    origins, axes, R = np.empty((m, 3)), np.empty((m, 3)), np.eye(3)
    forward(theta, length, False, origins, axes, R)
    J = np.empty((6, m))
    fill_jacobian(origins, axes, J)
    error = report[:6]
    pose_error(origins[m - 1], R, reference, error)
    task = np.empty(6)
    for r in range(3):
        task[r] = reference[12 + r] - settings[K_POSITION] * error[r]
        task[3 + r] = reference[15 + r] - settings[K_ROTATION] * error[3 + r]

    L = np.zeros((6, 6))
    everything = np.ones(m, dtype=np.bool_)
    log_det = factor_gram(J, everything, 0.0, L)
    manipulability = np.exp(0.5 * log_det)
    damping = 0.0
    scaled = manipulability / length**3
    if settings[DAMPING] > 0.0 and scaled < settings[DAMPED_BELOW]:
        damping = settings[DAMPING] * (1.0 - scaled / settings[DAMPED_BELOW])
        factor_gram(J, everything, damping, L)
    report[MANIPULABILITY] = manipulability
    report[AT_BOUND] = report[RESIDUAL] = 0.0
    report[SINGULAR] = 1.0 if damping == 0.0 and manipulability < 1e-9 else 0.0

    wanted = np.empty(m)
    report[DISTANCE] = cost_gradient(theta, origins, axes, J, L, log_det, target, limits, settings, wanted)
    if report[SINGULAR] > 0.0:
        return np.zeros(m)
    norm = 0.0
    for j in range(m):
        wanted[j] *= settings[ALPHA]
        norm += wanted[j] * wanted[j]
    norm = np.sqrt(norm)
    if norm > settings[MAX_NULL_RATE]:
        for j in range(m):
            wanted[j] *= settings[MAX_NULL_RATE] / norm
    low, high = np.full(m, -np.inf), np.full(m, np.inf)
    if settings[BOUNDED] > 0.0:
        for j in range(m):
            low[j], high[j] = joint_bounds(theta[j], limits[j], settings[LIMIT_GAIN], settings[MAX_RATE])
    rates, report[AT_BOUND], report[RESIDUAL] = bounded_rates(J, wanted, task, low, high, damping, L)
    return rates
