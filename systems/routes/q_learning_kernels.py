"""The compiled loop of Q-learning on a table of transitions."""

import numpy as np
from numba import njit

from ..random_kernels import next_random, uniform, unit_share


@njit(cache=True)
def drawn_outcome(row: np.ndarray, rng: np.ndarray) -> int:
    """An outcome by its cumulative probabilities (O,); takes no random number where there is only one."""
    if row[0] >= 1.0:
        return 0
    u = uniform(rng)
    o = 0
    while o < len(row) - 1 and u >= row[o]:
        o += 1
    return o


@njit(cache=True)
def _greedy(q: np.ndarray, s: int, bits: np.int64 | int) -> np.int64 | int:
    """The best motion; among equals one by two random bits, so that none is preferred before anything is known."""
    best = max(max(q[s, 0], q[s, 1]), max(q[s, 2], q[s, 3]))
    for k in range(4):
        a = (k + bits) & 3
        if q[s, a] == best:
            return a
    return 0


@njit(cache=True)
def _update(
    q: np.ndarray, visits: np.ndarray, s: int, a: np.int64 | int, n: int, gain: float, rates: tuple[float, float, float]
) -> None:
    """Eq. 8 for motion `a` in state `s` that led to `n`; rates: learning rate, its decay, discount."""
    alpha, decay, gamma = rates
    target = gain
    if n >= 0:
        target += gamma * max(max(q[n, 0], q[n, 1]), max(q[n, 2], q[n, 3]))
    if decay > 0.0:
        alpha /= 1.0 + decay * visits[s, a]
        visits[s, a] += 1
    q[s, a] += alpha * (target - q[s, a])


@njit(cache=True, nogil=True)
def q_steps(
    q: np.ndarray,
    visits: np.ndarray,
    problem: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    start: int,
    anywhere: np.ndarray,
    rates: tuple[float, float, float],
    parameters: tuple[float, float, int],
    most_steps: int,
    counters: np.ndarray,
    earned: np.ndarray,
    rng: np.ndarray,
    log_motions: np.ndarray,
    log_rewards: np.ndarray,
) -> tuple[int, int]:
    """Learns for `most_steps` motions or until `log_motions` is full; all arrays are changed in place.

    Args:
        q: (S, 4). visits: (S, 4) int32.
        problem: successors and rewards (S, 4, O), cumulative probabilities (T, 4, O), terrain (nx ny,).
        anywhere: (K,) states that an episode may also start from.
        rates: learning rate, its decay, discount.
        parameters: exploration, share of episodes that start anywhere, motions of an episode at most.
        counters: (3,) int64, state now, motions in this episode so far, whether it began at `start`.
        earned: (1,) rewards in this episode.
        log_motions, log_rewards: (E,) of episodes that began at `start`; motions are negative without the goal.

    Returns:
        Episodes that began at `start` and ended; motions made.
    """
    successor, reward, cumulative, terrain = problem
    epsilon, wander, cap = parameters
    certain = successor.shape[2] == 1
    ended, done = 0, 0
    s, motions, logged = counters[0], counters[1], counters[2]
    total = earned[0]
    while done < most_steps and ended < len(log_motions):
        done += 1
        r = next_random(rng)
        bits = np.int64((r >> np.uint64(5)) & np.uint64(3))
        a = bits if unit_share(r) < epsilon else _greedy(q, s, bits)
        o = 0 if certain else drawn_outcome(cumulative[terrain[s // 8], a], rng)
        n, gain = successor[s, a, o], reward[s, a, o]
        _update(q, visits, s, a, n, gain, rates)
        motions += 1
        total += gain
        s = n
        if n < 0 or motions >= cap:
            if logged:
                log_motions[ended] = motions if n < 0 else -motions
                log_rewards[ended] = total
                ended += 1
            s, motions, logged, total = start, 0, 1, 0.0
            if wander > 0.0 and uniform(rng) < wander:
                s, logged = anywhere[int(uniform(rng) * len(anywhere))], 0
    counters[0], counters[1], counters[2], earned[0] = s, motions, logged, total
    return ended, done
