"""Routes and sets of landmarks that evolve together (S4-d)."""

from dataclasses import dataclass

import numpy as np

from ..config import check_config
from ..errors import ConfigError
from ..random_kernels import seeded
from .evolution_config import EvolutionConfig
from .follow_kernels import follow, route_length, sides_seen
from .memetic_evolution import evolve_together
from .paper_kernels import evolve_as_published
from .problem import PlacementProblem, sites_of, word_of


@dataclass(frozen=True, eq=False)
class Placement:
    """A route, and the landmarks that are added for it. Read-only.

    Attributes:
        order: (n,) measuring points 1 … n as they are visited.
        chosen: (k,) bool, which sites have a box. sites: (m, 2) where the boxes are [m].
        route: (p, 2) points in W [m], from the start to the last measuring point.
        stops: (n,) which points of `route` are the measuring points `order`.
        length: [m].
        largest_error: expected along the route [m]. within_limit: whether it is nowhere above what is allowed.
        side_score: mean of the paper's Eval over the nodes of the route, in [0, 2].
        curve: (g, 3) number of landmarks, length [m], and mean Eval (less penalties) of the best so far, by generation.
        evaluations: pairs of a route and a set that were evaluated.
        routes, sets: the populations in the end, to go on from: (N, n), and words (M,).
    """

    order: np.ndarray
    chosen: np.ndarray
    sites: np.ndarray
    route: np.ndarray
    stops: np.ndarray
    length: float
    largest_error: float
    within_limit: bool
    side_score: float
    curve: np.ndarray
    evaluations: int
    routes: np.ndarray
    sets: np.ndarray

    def __deepcopy__(self, memo: dict) -> "Placement":
        return self


def evolve(
    problem: PlacementProblem,
    config: EvolutionConfig | None = None,
    *,
    least: int = 0,
    before: Placement | None = None,
) -> Placement:
    """Evolves routes and sets of landmarks of at least `least` sites.

    Preset "paper": Eq. 1 to 3. Preset "ours": the cost is the route's length, and `landmark_worth` for every landmark;
    routes along which the error may exceed its limit (`follow`) come after all others.

    Args:
        before: populations to go on from.

    Raises:
        ConfigError: a value of `config` or `least` is out of range.
    """
    config = config or EvolutionConfig()
    check_config(config, key="evolution")
    sites, n = len(problem.sites), len(problem.points) - 1
    if not 0 <= least <= sites:
        raise ConfigError("out of range", key="least", value=least, valid=f"0 to {sites} landmarks")
    rng = np.random.default_rng(config.seed)
    routes, sets = _populations(problem, config, least, before, rng)
    if config.preset == "paper":
        curve, evaluations = evolve_as_published(
            routes, sets, sites, problem.lengths, problem.sides(), config.generations, config.patience, config.flip,
            least, seeded(config.seed),
        )  # fmt: skip
    else:
        weights = np.array([config.landmark_worth, 0.0, config.calm_worth, config.longest or np.inf, 1e3])
        # Any excess is worse than a landmark everywhere and the longest route.
        weights[1] = config.landmark_worth * (sites + 1) + n * problem.lengths.max()
        routes, sets, curve, evaluations = evolve_together(problem, routes, sets, least, weights, config, rng)
    return placement_of(problem, routes[0], sites_of(sets[0], sites), curve, evaluations, routes, sets)


def placement_of(
    problem: PlacementProblem,
    order: np.ndarray,
    chosen: np.ndarray,
    curve: np.ndarray | None = None,
    evaluations: int = 0,
    routes: np.ndarray | None = None,
    sets: np.ndarray | None = None,
) -> Placement:
    """The placement of an order (n,) of the points 1 … n and of chosen sites (k,) bool."""
    order, chosen = np.asarray(order, np.int64), np.asarray(chosen, bool)
    n = len(problem.points)
    legs = np.concatenate([[0], order[:-1]]) * n + order
    ways = [problem.ways[leg] for leg in legs]
    excess, _, _ = follow(order, word_of(chosen), problem.tables(), np.zeros(0))
    _, errors = problem.errors_along(order, chosen)
    sides = problem.sides()
    as_published = sides._replace(penalty=np.zeros_like(sides.penalty))
    return Placement(
        order=order,
        chosen=chosen,
        sites=problem.sites[chosen],
        route=np.concatenate([problem.points[:1], *(way[1:] for way in ways)]),
        stops=np.cumsum([len(way) - 1 for way in ways]),
        length=float(route_length(order, problem.lengths)),
        largest_error=float(errors.max()),
        within_limit=excess == 0.0,
        side_score=float(sides_seen(order, word_of(chosen), n, as_published)),
        curve=np.zeros((0, 3)) if curve is None else curve,
        evaluations=int(evaluations),
        routes=order[None] if routes is None else routes,
        sets=np.array([word_of(chosen)]) if sets is None else sets,
    )


def _populations(
    problem: PlacementProblem, config: EvolutionConfig, least: int, before: Placement | None, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Routes (N, n) and sets (M,) to begin with: those from before, else random ones."""
    n, sites = len(problem.points) - 1, len(problem.sites)
    routes = np.array([rng.permutation(n) + 1 for _ in range(config.routes)])
    chosen = rng.random((config.sets, sites)) < rng.uniform(least / sites, 1, (config.sets, 1))
    for row in chosen:
        while row.sum() < least:
            row[rng.integers(sites)] = True
    sets = np.array([word_of(row) for row in chosen])
    if before is not None:
        kept = min(len(routes), len(before.routes))
        routes[:kept] = before.routes[:kept]
        good = np.array([word for word in before.sets if sites_of(word, sites).sum() >= least], np.int64)
        kept = min(len(sets) // 2, len(good))
        sets[:kept] = good[:kept]
    return routes, sets
