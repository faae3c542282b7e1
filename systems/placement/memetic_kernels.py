"""Compiled parts of our co-evolution: cost of a pair, and the local searches over orders and over sets of sites."""

import numpy as np
from numba import njit

from ..random_kernels import shuffled
from .follow_kernels import Tables, Word, bits_set, follow, route_length


@njit(cache=True)
def pair_cost(order: np.ndarray, chosen: Word, tables: Tables, weights: np.ndarray) -> float:
    """Cost [m] of a route with a set of sites.

    Args:
        weights: metres of route that a landmark is worth, that an excess of 1 over 1 m costs, that the mean of error /
            limit costs, the longest route that is allowed, and what a metre beyond it costs.
    """
    length = route_length(order, tables.lengths)
    excess, share, _ = follow(order, chosen, tables, np.zeros(0))
    cost = length + weights[0] * bits_set(chosen) + weights[1] * excess + weights[2] * share
    if excess > 0.0:
        cost += weights[1]
    return cost + weights[4] * max(0.0, length - weights[3])


@njit(cache=True)
def cost_table(routes: np.ndarray, sets: np.ndarray, tables: Tables, weights: np.ndarray) -> np.ndarray:
    """(N, M) costs of all pairs."""
    table = np.empty((len(routes), len(sets)))
    for i in range(len(routes)):
        for j in range(len(sets)):
            table[i, j] = pair_cost(routes[i], sets[j], tables, weights)
    return table


@njit(cache=True)
def shorten(order: np.ndarray, lengths: np.ndarray) -> None:
    """Shortens an open route in place by 2-opt and or-opt (pieces of up to three, either way round) until neither
    does."""
    n = len(order)
    better = True
    while better:
        better = False
        for a in range(n - 1):
            before = order[a - 1] if a > 0 else 0
            for b in range(a + 1, n):
                old, new = lengths[before, order[a]], lengths[before, order[b]]
                if b + 1 < n:
                    old += lengths[order[b], order[b + 1]]
                    new += lengths[order[a], order[b + 1]]
                if new < old - 1e-9:
                    order[a : b + 1] = order[a : b + 1][::-1].copy()
                    better = True
        for size in range(1, min(4, n)):
            for a in range(n - size + 1):
                if _move_piece(order, a, size, lengths):
                    better = True


@njit(cache=True)
def _move_piece(order: np.ndarray, a: int, size: int, lengths: np.ndarray) -> bool:
    """Moves the piece of `size` points at `a` to where it makes the route shortest, if that is shorter than now."""
    n = len(order)
    piece = order[a : a + size].copy()
    rest = np.empty(n - size, np.int64)
    rest[:a], rest[a:] = order[:a], order[a + size :]
    now = lengths[order[a - 1] if a > 0 else 0, piece[0]]
    if a + size < n:
        now += lengths[piece[size - 1], order[a + size]]
        now -= lengths[order[a - 1] if a > 0 else 0, order[a + size]]
    best, place, turned = now - 1e-9, -1, False
    for k in range(n - size + 1):
        before = rest[k - 1] if k > 0 else 0
        for way in range(2):
            head, tail = (piece[0], piece[size - 1]) if way == 0 else (piece[size - 1], piece[0])
            gain = lengths[before, head]
            if k < n - size:
                gain += lengths[tail, rest[k]] - lengths[before, rest[k]]
            if gain < best:
                best, place, turned = gain, k, way == 1
    if place < 0:
        return False
    order[:place] = rest[:place]
    order[place : place + size] = piece[::-1] if turned else piece
    order[place + size :] = rest[place:]
    return True


@njit(cache=True)
def improve_sites(
    order: np.ndarray, chosen: Word, least: int, tables: Tables, weights: np.ndarray, rng: np.ndarray
) -> tuple[Word, float, int]:
    """Improves a set of sites for a route: adds the site that lowers the cost most until none does, then drops and
    swaps sites in random order while that lowers it.

    Returns:
        The set, of `least` sites or more, its cost, and the number of evaluations.
    """
    sites = tables.added.shape[1]
    cost = pair_cost(order, chosen, tables, weights)
    evaluations = 1
    while True:
        best, site = cost if bits_set(chosen) >= least else np.inf, -1
        for s in range(sites):
            if not (chosen >> s) & 1:
                other = pair_cost(order, chosen | (np.int64(1) << s), tables, weights)
                evaluations += 1
                if other < best:
                    best, site = other, s
        if site < 0:
            break
        chosen |= np.int64(1) << site
        cost = best
    places = shuffled(rng, sites)
    better = True
    while better:
        better = False
        for s in places:
            if not (chosen >> s) & 1:
                continue
            without = chosen & ~(np.int64(1) << s)
            if bits_set(without) >= least:
                other = pair_cost(order, without, tables, weights)
                evaluations += 1
                if other < cost - 1e-9:
                    chosen, cost, better = without, other, True
                    continue
            for t in places:
                if (chosen >> t) & 1:
                    continue
                swapped = without | (np.int64(1) << t)
                other = pair_cost(order, swapped, tables, weights)
                evaluations += 1
                if other < cost - 1e-9:
                    chosen, cost, better = swapped, other, True
                    break
    return chosen, cost, evaluations


@njit(cache=True)
def improve_route(
    order: np.ndarray, chosen: Word, least: int, tables: Tables, weights: np.ndarray
) -> tuple[float, Word, int]:
    """Improves a route in place by 2-opt and by moving single points, each with the set as it is or less one site.

    Returns:
        Cost, set and the number of evaluations.
    """
    n = len(order)
    cost = pair_cost(order, chosen, tables, weights)
    evaluations = 1
    better = True
    while better:
        better = False
        for a in range(n):
            for b in range(n):
                if a == b:
                    continue
                other = order.copy()
                if a < b:
                    other[a : b + 1] = order[a : b + 1][::-1]
                else:
                    other[b] = order[a]
                    other[b + 1 : a + 1] = order[b:a]
                length = route_length(other, tables.lengths)
                # With one landmark less and no error at all it would cost at least this.
                if length + weights[0] * (bits_set(chosen) - 1) >= cost or length > weights[3]:
                    continue
                now = pair_cost(other, chosen, tables, weights)
                evaluations += 1
                best, fewer = now, chosen
                if bits_set(chosen) > least and now < cost + weights[0]:
                    for s in range(tables.added.shape[1]):
                        if (chosen >> s) & 1:
                            without = chosen & ~(np.int64(1) << s)
                            now = pair_cost(other, without, tables, weights)
                            evaluations += 1
                            if now < best:
                                best, fewer = now, without
                if best < cost - 1e-9:
                    order[:], chosen, cost, better = other, fewer, best, True
    return cost, chosen, evaluations
