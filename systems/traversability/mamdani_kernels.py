"""Compiled min-max-centroid inference with three inputs of three terms each."""

import numpy as np
from numba import njit


@njit(cache=True, fastmath=True)
def _membership(x: float, a: float, b: float, c: float, d: float) -> float:
    if x >= b:
        if x <= c:
            return 1.0
        return (d - x) / (d - c) if x < d else 0.0
    return (x - a) / (b - a) if x > a else 0.0


@njit(cache=True, fastmath=True)
def _centroid(met: np.ndarray, grades: np.ndarray, universe: np.ndarray, lowest: float) -> float:
    moment = 0.0
    area = 0.0
    m0, m1, m2, m3 = met[0], met[1], met[2], met[3]
    for p in range(universe.shape[0]):
        value = max(
            max(min(m0, grades[0, p]), min(m1, grades[1, p])), max(min(m2, grades[2, p]), min(m3, grades[3, p]))
        )
        # Trapezoidal rule: the ends count half.
        if p == 0 or p == universe.shape[0] - 1:
            value *= 0.5
        moment += value * universe[p]
        area += value
    return moment / area if area > 0.0 else lowest


@njit(cache=True)
def infer_all(
    features: np.ndarray,
    sizes: np.ndarray,
    rules: np.ndarray,
    grades: np.ndarray,
    universe: np.ndarray,
    lowest: float,
) -> tuple[np.ndarray, np.ndarray]:
    """τ (N,) and how far each grade is met (N, 4) of features (N, 3).

    Args:
        sizes: corners of the terms, (3 inputs, 3 terms, 4). rules: grade by the three terms, (3, 3, 3).
        grades: membership of the points of `universe` (S,) in each grade, (4, S). lowest: τ where nothing is known.
    """
    count = features.shape[0]
    tau = np.empty(count)
    activations = np.zeros((count, 4))
    member = np.zeros((3, 3))
    for n in range(count):
        finite = True
        for i in range(3):
            x = features[n, i]
            if not np.isfinite(x):
                finite = False
                break
            for j in range(3):
                member[i, j] = _membership(x, sizes[i, j, 0], sizes[i, j, 1], sizes[i, j, 2], sizes[i, j, 3])
        if not finite:
            activations[n, 0] = 1.0
            tau[n] = lowest
            continue
        met = activations[n]
        for i in range(3):
            if member[0, i] <= 0.0:
                continue
            for j in range(3):
                both = min(member[0, i], member[1, j])
                if both <= 0.0:
                    continue
                for k in range(3):
                    value = min(both, member[2, k])
                    grade = rules[i, j, k]
                    if value > met[grade]:
                        met[grade] = value
        tau[n] = _centroid(met, grades, universe, lowest)
    return tau, activations
