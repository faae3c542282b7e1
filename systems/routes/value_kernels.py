"""Compiled sweeps of value iteration, and the Markov chain that a policy makes of a task."""

import numpy as np
from numba import njit


@njit(cache=True)
def sweep(
    value: np.ndarray,
    order: np.ndarray,
    inside: np.ndarray,
    shape: tuple[int, int],
    reach: int,
    problem: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float],
    limits: tuple[float, float, int],
) -> tuple[int, float]:
    """Improves `value` (S,) in place until no value changes by more than a tolerance.

    Args:
        order: (R,) cells in the order in which they are visited; `inside` (nx ny,) bool is true for these.
        shape: nx, ny. reach: cells that a motion goes at most.
        problem: successors and rewards (S, 4, O), probabilities (T, 4, O), terrain (nx ny,), discount.
        limits: tolerance (in parts of a value), what is added to a value for that, largest number of sweeps.

    Returns:
        Sweeps, and the largest change in the last, in parts of a value.
    """
    successor, reward, probability, terrain, gamma = problem
    tolerance, floor, most = limits
    nx, ny = shape
    outcomes = probability.shape[2]
    stale = inside.copy()
    change, sweeps = np.inf, 0
    while sweeps < most and change > tolerance:
        change = 0.0
        sweeps += 1
        for cell in order:
            if not stale[cell]:
                continue
            stale[cell] = False
            row = probability[terrain[cell]]
            largest = 0.0
            # Around the headings and back, so that a turn of any size is seen at once.
            for turn in range(16):
                s = cell * 8 + (turn if turn < 8 else 15 - turn)
                best = -np.inf
                for a in range(4):
                    v, stay = 0.0, 0.0
                    for o in range(outcomes):
                        p = row[a, o]
                        if p == 0.0:
                            continue
                        n = successor[s, a, o]
                        v += p * reward[s, a, o]
                        if n == s:
                            stay += p
                        elif n >= 0:
                            v += p * gamma * value[n]
                    if gamma * stay < 1.0:
                        best = max(best, v / (1.0 - gamma * stay))
                largest = max(largest, abs(best - value[s]) / (abs(best) + floor))
                value[s] = best
            change = max(change, largest)
            # Less than the tolerance adds up over many small changes, so that a part of it counts already.
            if largest > 0.1 * tolerance:
                x, y = cell // ny, cell % ny
                for i in range(max(0, x - reach), min(nx, x + reach + 1)):
                    for j in range(max(0, y - reach), min(ny, y + reach + 1)):
                        stale[i * ny + j] = inside[i * ny + j]
    return sweeps, change


@njit(cache=True)
def action_values(
    value: np.ndarray, order: np.ndarray, problem: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]
) -> np.ndarray:
    """(S, 4) values of the motions in the cells of `order`, 0 where `value` (S,) is 0 (the goal), else -inf."""
    successor, reward, probability, terrain, gamma = problem
    q = np.full((len(value), 4), -np.inf)
    for s in range(len(value)):
        if value[s] == 0.0:
            q[s] = 0.0
    for cell in order:
        row = probability[terrain[cell]]
        for s in range(cell * 8, cell * 8 + 8):
            for a in range(4):
                v = 0.0
                for o in range(row.shape[1]):
                    if row[a, o] > 0.0:
                        n = successor[s, a, o]
                        v += row[a, o] * (reward[s, a, o] + (0.0 if n < 0 else gamma * value[n]))
                q[s, a] = v
    return q


@njit(cache=True)
def follow(
    successor: np.ndarray,
    reward: np.ndarray,
    probability: np.ndarray,
    terrain: np.ndarray,
    actions: np.ndarray,
    start: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, bool]:
    """States met from `start`, the arcs between them, their mean rewards, and whether all of them lead to the goal."""
    outcomes = successor.shape[2]
    number = np.full(len(successor), -1)
    states = np.empty(len(successor), np.int64)
    number[start], states[0] = 0, start
    count, arcs = 1, 0
    k = 0
    while k < count:
        s = states[k]
        a = actions[s]
        for o in range(outcomes):
            n = successor[s, a, o]
            if probability[terrain[s // 8], a, o] > 0.0 and n >= 0:
                arcs += 1
                if number[n] < 0:
                    number[n], states[count] = count, n
                    count += 1
        k += 1
    states = states[:count]
    rows, columns, weights = np.empty(arcs, np.int64), np.empty(arcs, np.int64), np.empty(arcs)
    earned = np.zeros(count)
    ends = np.zeros(count, np.bool_)
    arc = 0
    for k in range(count):
        s = states[k]
        a = actions[s]
        for o in range(outcomes):
            p = probability[terrain[s // 8], a, o]
            if p > 0.0:
                n = successor[s, a, o]
                earned[k] += p * reward[s, a, o]
                if n >= 0:
                    rows[arc], columns[arc], weights[arc] = k, number[n], p
                    arc += 1
                else:
                    ends[k] = True
    # Arcs that lead to states that end: backwards until nothing is added.
    grown = True
    while grown:
        grown = False
        for arc in range(arcs - 1, -1, -1):
            if ends[columns[arc]] and not ends[rows[arc]]:
                ends[rows[arc]] = True
                grown = True
    return states, rows, columns, weights, earned, bool(ends.all())
