"""The compiled loop of the paper's co-evolution: its operators, its fitness, elitist (S4-d; paper, section 3.3)."""

import numpy as np
from numba import njit

from ..random_kernels import draw, uniform
from .follow_kernels import Sides, Word, bits_set, route_length, sides_seen


@njit(cache=True)
def vary_route(order: np.ndarray, rng: np.ndarray) -> None:
    """One of the paper's three operators: swap two, move one before another, swap neighbours."""
    n = len(order)
    if n < 2:
        return
    kind = draw(rng, 3)
    a, b = draw(rng, n), draw(rng, n)
    if kind == 0:
        order[a], order[b] = order[b], order[a]
    elif kind == 1:
        moved = order[a]
        if a < b:
            for k in range(a, b - 1):
                order[k] = order[k + 1]
            order[b - 1] = moved
        else:
            for k in range(a, b, -1):
                order[k] = order[k - 1]
            order[b] = moved
    else:
        a = draw(rng, n - 1)
        order[a], order[a + 1] = order[a + 1], order[a]


@njit(cache=True)
def vary_sites(one: Word, other: Word, sites: int, flip: float, least: int, rng: np.ndarray) -> Word:
    """Uniform crossover of two sets of sites, a flip of a random one with probability `flip`, and random ones added
    until there are `least`."""
    child = np.int64(0)
    for s in range(sites):
        child |= (one if uniform(rng) < 0.5 else other) & (np.int64(1) << s)
    if uniform(rng) < flip:
        child ^= np.int64(1) << draw(rng, sites)
    while bits_set(child) < least:
        child |= np.int64(1) << draw(rng, sites)
    return child


@njit(cache=True)
def _from_best(score: np.ndarray) -> np.ndarray:
    """Indices of scores (n,) from the highest; equals stay in their order."""
    order = np.arange(len(score))
    for k in range(1, len(order)):
        at = k
        while at > 0 and score[order[at]] > score[order[at - 1]]:
            order[at], order[at - 1] = order[at - 1], order[at]
            at -= 1
    return order


@njit(cache=True)
def evolve_as_published(
    routes: np.ndarray,
    sets: np.ndarray,
    sites: int,
    lengths: np.ndarray,
    sides: Sides,
    generations: int,
    patience: int,
    flip: float,
    least: int,
    rng: np.ndarray,
) -> tuple[np.ndarray, int]:
    """Evolves routes (N, n) and sets (M,) of sites in place, the best first.

    Every parent has a child in each generation. Parents and children are judged by Eq. 1 and 2 against the parents of
    the other population, and the best N and M are the next parents. It ends when the best of both has not changed for
    `patience` generations.

    Returns:
        (g, 3) number of landmarks, length [m] and mean Eval of the best route with the best set, after every
        generation, and the number of pairs that were evaluated.
    """
    n, m = len(routes), len(sets)
    points = len(lengths)
    all_routes = np.empty((2 * n, routes.shape[1]), np.int64)
    all_sets = np.empty(2 * m, np.int64)
    curve = np.empty((generations, 3))
    still, evaluations = 0, 0
    for g in range(generations):
        all_routes[:n], all_sets[:m] = routes, sets
        for k in range(n):
            all_routes[n + k] = routes[draw(rng, n)]
            vary_route(all_routes[n + k], rng)
        for k in range(m):
            all_sets[m + k] = vary_sites(sets[draw(rng, m)], sets[draw(rng, m)], sites, flip, least, rng)
        metres = np.empty(2 * n)
        score = np.zeros(2 * n)
        for i in range(2 * n):
            metres[i] = route_length(all_routes[i], lengths)
            for j in range(m):
                score[i] += sides_seen(all_routes[i], sets[j], points, sides)
        longest = metres.max()
        for i in range(2 * n):
            score[i] *= 1.0 - metres[i] / longest
        value = np.zeros(2 * m)
        for j in range(2 * m):
            for i in range(n):
                value[j] += sides_seen(routes[i], all_sets[j], points, sides)
            value[j] *= 1.0 - bits_set(all_sets[j]) / sites
        evaluations += 4 * n * m
        best_routes, best_sets = _from_best(score), _from_best(value)
        same = all_sets[best_sets[0]] == sets[0] and (all_routes[best_routes[0]] == routes[0]).all()
        for k in range(n):
            routes[k] = all_routes[best_routes[k]]
        for k in range(m):
            sets[k] = all_sets[best_sets[k]]
        curve[g, 0] = bits_set(sets[0])
        curve[g, 1] = route_length(routes[0], lengths)
        curve[g, 2] = sides_seen(routes[0], sets[0], points, sides)
        still = still + 1 if same else 0
        if still >= patience:
            return curve[: g + 1], evaluations
    return curve, evaluations
