"""The fewest landmarks for a route, proved: integer programming over the sets that are not enough."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp

from ..errors import PlanError
from .follow_kernels import follow
from .problem import PlacementProblem, word_of


@dataclass(frozen=True, eq=False)
class FewestSites:
    """The fewest landmarks for a route. Read-only.

    Attributes:
        chosen: (k,) bool, a set within the limit.
        proved: whether no smaller set is; False when the rounds ran out, and `chosen` is then all sites.
        least: number of landmarks below which, as proved, there is none.
        rounds: sets that were found to be too little.
    """

    chosen: np.ndarray
    proved: bool
    least: int
    rounds: int


def fewest_sites(problem: PlacementProblem, order: np.ndarray, *, least: int = 0, rounds: int = 2000) -> FewestSites:
    """Finds the fewest sites, `least` or more, with which the error along a route is nowhere above its limit.

    More landmarks never make the error larger. So a set that is not enough says: at least one of the sites that it
    lacks. The integer program finds the smallest set that meets all that was said so far; when it is enough, none
    smaller is, else it is filled up as far as it stays too little, and says more (implicit hitting sets).

    Raises:
        PlanError: not even all sites are enough.
    """
    sites, tables = len(problem.sites), problem.tables()
    order = np.asarray(order, np.int64)

    def is_enough(chosen: np.ndarray) -> bool:
        return bool(follow(order, word_of(chosen), tables, np.zeros(0))[0] == 0.0)

    if not is_enough(np.ones(sites, bool)):
        raise PlanError("all sites together do not keep the error within its limit", key="error_limit")
    rows = [np.ones(sites)]
    needed = [float(least)]
    for k in range(rounds):
        found = milp(
            np.ones(sites),
            constraints=LinearConstraint(np.array(rows), np.array(needed), np.inf),
            integrality=np.ones(sites),
            bounds=Bounds(0, 1),
        )
        chosen = found.x > 0.5
        if is_enough(chosen):
            return FewestSites(chosen, True, int(chosen.sum()), k)
        for s in np.flatnonzero(~chosen):
            more = chosen.copy()
            more[s] = True
            if not is_enough(more):
                chosen = more
        rows.append((~chosen).astype(float))
        needed.append(1.0)
    return FewestSites(np.ones(sites, bool), False, int(np.ceil(found.fun - 1e-6)), rounds)
