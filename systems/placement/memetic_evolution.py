"""Our co-evolution: two populations judged by the best of each other, and improved by local search."""

import numpy as np

from ..random_kernels import seeded
from .evolution_config import EvolutionConfig
from .follow_kernels import bits_set, route_length, sides_seen
from .memetic_kernels import cost_table, improve_route, improve_sites, shorten
from .paper_kernels import vary_route, vary_sites
from .problem import PlacementProblem

# Individuals of the other population that one is judged against: by the best of them.
_PARTNERS = 3


def evolve_together(
    problem: PlacementProblem,
    routes: np.ndarray,
    sets: np.ndarray,
    least: int,
    weights: np.ndarray,
    config: EvolutionConfig,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Evolves routes (N, n) and sets (M,) of sites, each judged by its cheapest pair with the best of the others.

    Children come about by the paper's operators. Every second route is shortened by 2-opt and or-opt. In each
    generation one set is improved for the best route, one for another, and one varied route together with its set.

    Args:
        weights: see `pair_cost`.

    Returns:
        Routes and sets, the best first; (g, 3) number of landmarks, length [m] and mean Eval of the best pair; number
        of evaluations.
    """
    tables, sides, sites = problem.tables(), problem.sides(), len(problem.sites)
    state = seeded(config.seed)
    routes, sets = routes.copy(), sets.copy()
    for order in routes:
        shorten(order, problem.lengths)
    routes = routes[np.argsort([route_length(order, problem.lengths) for order in routes], kind="stable")]
    sets[0], best, evaluations = improve_sites(routes[0], sets[0], least, tables, weights, state)
    pair = (routes[0].copy(), sets[0])
    curve, still = [], 0
    for _ in range(config.generations):
        children = [*routes.copy(), *routes[rng.integers(len(routes), size=len(routes))]]
        for k, order in enumerate(children[len(routes) :]):
            for _ in range(1 + rng.integers(3)):
                vary_route(order, state)
            if k % 2:
                shorten(order, problem.lengths)
        all_routes = np.unique(np.array([pair[0], *children]), axis=0)
        mothers = sets[rng.integers(len(sets), size=(max(len(sets), 2), 2))]  # few sites have few sets
        young = [vary_sites(a, b, sites, config.flip, least, state) for a, b in mothers]
        young[0], _, more = improve_sites(pair[0], young[0], least, tables, weights, state)
        other = routes[rng.integers(len(routes))]
        young[1], _, again = improve_sites(other, young[1], least, tables, weights, state)
        all_sets = np.unique(np.array([pair[1], *sets, *young]))
        route_costs = cost_table(all_routes, np.array([pair[1], *sets[: _PARTNERS - 1]]), tables, weights)
        set_costs = cost_table(np.array([pair[0], *routes[: _PARTNERS - 1], other]), all_sets, tables, weights)
        evaluations += more + again + route_costs.size + set_costs.size
        by_route, by_set = route_costs.min(axis=1), set_costs.min(axis=0)
        routes = all_routes[np.argsort(by_route, kind="stable")[: config.routes]]
        sets = all_sets[np.argsort(by_set, kind="stable")[: config.sets]]
        found = cost_table(routes[:_PARTNERS], sets[:_PARTNERS], tables, weights)
        evaluations += found.size
        i, j = np.unravel_index(int(np.argmin(found)), found.shape)
        candidate, word, cost = routes[i].copy(), sets[j], float(found[i, j])
        # A route near the best one, or of the population, improved together with the set.
        near = pair[0].copy() if still % 2 else routes[rng.integers(len(routes))].copy()
        for _ in range(1 + rng.integers(3)):
            vary_route(near, state)
        start = pair[1] if rng.random() < 0.5 else word
        near_cost, near_word, more = improve_route(near, start, least, tables, weights)
        near_word, near_cost, again = improve_sites(near, near_word, least, tables, weights, state)
        evaluations += more + again
        if near_cost < cost:
            candidate, word, cost = near, near_word, near_cost
        routes[-1], sets[-1] = near, near_word
        still += 1
        if cost < best - 1e-9:
            best, pair, still = cost, (candidate, word), 0
        score = sides_seen(pair[0], pair[1], len(tables.lengths), sides)
        curve.append([bits_set(pair[1]), route_length(pair[0], problem.lengths), score])
        if still >= config.patience:
            break
    routes = _first(routes, pair[0])
    sets = _first(sets, pair[1])
    return routes, sets, np.array(curve), evaluations


def _first(population: np.ndarray, best: np.ndarray | np.int64) -> np.ndarray:
    """The population with `best` in front, once."""
    same = (population == best).reshape(len(population), -1).all(axis=1)
    return np.concatenate([np.array([best]), population[~same]])[: len(population)]
