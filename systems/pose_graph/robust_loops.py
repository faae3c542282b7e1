"""Which loops to believe: the largest set that agrees with itself and with the odometry.

Odometry is believed, loops are not; all is the chi-square test of a closed way.

1. **Noise**: stated covariances are often far too wide; where many loops are near each other, their cycles tell how
   wide they really are (`noise_scale`). Gates are never wider than what was stated.
2. **Seed**: each loop against those a few steps of odometry away from it, see `consistency`. The seed is of those that
   more neighbours speak for than against, `min_votes` at least: two false ones that agree with a third are not enough.
3. **Growth**: with the seed alone the graph is optimised. Loops that now fit as well as the seed are added; then those
   that fit within the uncertainty of the best way round, over odometry and accepted loops, where a false one hardly
   would by chance, and where the graph does not bend for them. With each round poses and gates get better.
4. **Decision**: what does not fit goes out, what does comes in, until nothing changes: truncated least squares from a
   start that is already good, where graduated methods such as GNC spend their time on finding one.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from ..config import check_config, quantity
from .consistency import LoopPairs
from .graph import LOOP, PLANAR, PoseGraph, chi_squared, dead_reckoning
from .optimize import Factors, optimize
from .rigid import inverse, logarithm

ACCEPTED = "accepted"
# Quantile of the cycles' errors from which the noise is told: below it are only true loops, if 60 % of them are.
_NOISE_QUANTILE = 0.35
_MIN_FOR_NOISE = 30
# Two loops are neighbours when the odometry between them adds less than this to the variance of each axis.
_NEAR = 6.0
# How far beyond the 99th percentile of the errors in the seed, in variance, a loop is still kept: noise has tails.
_TAIL = 25.0
# Graphs up to so many poses are tried from a chordal start too; larger ones are held by then.
_SMALL = 1000
# Between rounds the poses need not be exact, and a group that has not settled by then bends the graph; with fewer
# changes than this part of the loops, growth goes on.
_FEW_ITERATIONS, _FEW_LOOPS = 3, 0.02
# So many exact covariances a round.
_MAX_EXACT = 20
_MAX_CLIQUE_LOOPS = 200
# What a group may bend the graph by, for each loop after the first and degree of freedom: those left fit least.
_LEFT_OVER = 2.5


@dataclass(kw_only=True)
class RobustLoopsConfig:
    """When a loop is believed."""

    # [-] Share of true loops that the chi-square gate lets through.
    confidence: float = quantity(0.999, unit="-", above=0.5, high=0.999999)
    # [loops] How many of its nearest each loop is compared with.
    neighbours: int = quantity(12, unit="loops", low=1)
    # [loops] Neighbours that must agree with a loop before anything else is known.
    min_votes: int = quantity(3, unit="loops", low=1)
    # [-] How much wider, in variance, gates are than the noise found in the data; never wider than stated.
    noise_margin: float = quantity(4.0, unit="-", low=1)
    # [-] Largest chance that a false loop would fit as well, for one that is accepted without `min_votes` others.
    max_chance: float = quantity(0.05, unit="-", above=0, high=1)
    # [m] A false loop is off by anything up to this, along each axis, and by any turn.
    false_reach: float = quantity(20.0, unit="m", above=0)
    # [edges] Groups of loops are tried in the graph; those that fail may have gone through so many edges in all.
    max_trial_edges: int = quantity(40_000, unit="edges", low=0)
    # [rounds] Growth and decision end after so many at most.
    max_rounds: int = quantity(20, unit="rounds", low=1)


@dataclass(frozen=True, eq=False)
class LoopDecision:
    """What `decide_loops` found.

    Attributes:
        accepted: which edges count: all but the refused loops, (E,) bool.
        poses: optimum over them, (N, 4, 4).
        chi_squared: of every edge there, (E,).
        reasons: of every loop, in the order of `PoseGraph.loops`, `ACCEPTED` or why not.
        noise_scale: variance of the noise found, as a part of that stated.
    """

    accepted: np.ndarray
    poses: np.ndarray
    chi_squared: np.ndarray
    reasons: tuple[str, ...]
    noise_scale: float


def decide_loops(
    graph: PoseGraph, config: RobustLoopsConfig | None = None, *, believed: np.ndarray | None = None
) -> LoopDecision:
    """Decides loop by loop, see above.

    Args:
        believed: loops that were accepted before, a mask (E,): they start in the seed, and are judged like all others.

    Raises:
        PoseGraphError: two successive poses are not joined by odometry or registration.
    """
    config = config or RobustLoopsConfig()
    check_config(config)
    return _Decision(graph, config, believed).run()


class _Decision:
    """The sets and poses that the steps hand on."""

    def __init__(self, graph: PoseGraph, config: RobustLoopsConfig, believed: np.ndarray | None):
        self.graph, self.config, self.loops = graph, config, graph.loops
        self.factors = Factors(graph)
        self.poses = dead_reckoning(graph)
        self.pairs = LoopPairs(graph, self.poses)
        self.dof = len(PLANAR) if graph.planar else 6
        self.gate = float(chi2.ppf(config.confidence, self.dof))
        self.kept = np.zeros(len(self.loops), bool)
        self.believed = self.kept if believed is None else believed[self.loops]
        self.scale, self.limit, self.failures = 1.0, self.gate, 0
        self.marginals: tuple[np.ndarray, Callable[[int, int], np.ndarray]] | None = None
        self.max_failures = int(np.clip(config.max_trial_edges // max(len(graph.i), 1), 3, 100))
        # Volume of positions and rotation vectors.
        span = 2 * config.false_reach
        self.log_space = np.log(span**2 * 2 * np.pi) if graph.planar else np.log(span**3 * 4 / 3 * np.pi**4)

    def run(self) -> LoopDecision:
        reasons = [""] * len(self.loops)
        self.kept = self.seed() | self.believed
        self.optimize(("odometry", "chordal"))
        fit = chi_squared(self.graph, self.poses)[self.loops]
        self.limit = self.find_limit(fit)
        for _ in range(self.config.max_rounds):
            before, self.kept = self.kept, fit <= self.limit
            changed = int((self.kept != before).sum())
            if changed:
                self.optimize(("poses",), _FEW_ITERATIONS)
            if changed <= _FEW_LOOPS * len(self.loops) and not self.grow(reasons) and not changed:
                break
            fit = chi_squared(self.graph, self.poses)[self.loops]
        self.optimize(("poses",))
        for loop in np.flatnonzero(self.kept):
            reasons[loop] = ACCEPTED
        accepted = self.edges()
        return LoopDecision(accepted, self.poses, chi_squared(self.graph, self.poses), tuple(reasons), self.scale)

    def edges(self) -> np.ndarray:
        """The edges that count now, (E,) bool."""
        edges = self.graph.kind != LOOP
        edges[self.loops[self.kept]] = True
        return edges

    def optimize(self, starts: tuple[str, ...], max_iterations: int | None = None) -> None:
        graph = self.graph.with_poses(self.poses)
        found = optimize(graph, edges=self.edges(), starts=starts, factors=self.factors, max_iterations=max_iterations)
        self.poses = found.poses

    def seed(self) -> np.ndarray:
        """Loops that enough of their neighbours speak for, (L,) bool; finds the noise scale."""
        a, b = self.pairs.neighbours(self.config.neighbours)
        errors, log_det = self.pairs.cycle_errors(a, b)
        # Near: the odometry between the ends adds less than so many times the variance of the two loops.
        alone = np.linalg.slogdet(self.pairs.covariance[:, self.pairs.used[:, None], self.pairs.used])[1]
        near = log_det <= 0.5 * (alone[a] + alone[b]) + self.dof * np.log(2 + 2 * _NEAR)
        if near.sum() >= _MIN_FOR_NOISE:
            found = np.quantile(errors[near], _NOISE_QUANTILE) / chi2.ppf(_NOISE_QUANTILE / 0.75, self.dof)
            self.scale = min(max(float(found), 1e-12), 1.0)
        self.a, self.b, self.agree = a[near], b[near], errors[near] <= self.pair_gate
        kept = np.ones(len(self.loops), bool)
        for _ in range(self.config.max_rounds):
            pro, con = self.votes(kept)
            again = (pro >= self.config.min_votes) & (pro > con)
            if (again == kept).all():
                break
            kept = again
        return kept

    @property
    def pair_gate(self) -> float:
        """Gate for covariances that are sums of stated ones, as wide as the noise in the data asks for."""
        return self.gate * min(self.config.noise_margin * self.scale, 1.0)

    def votes(self, among: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How many of the neighbours in a set (L,) bool speak for and against each loop of it, (L,) each."""
        live = among[self.a] & among[self.b]
        counts = [
            np.bincount(np.concatenate([self.a[pairs], self.b[pairs]]), minlength=len(self.loops))
            for pairs in (live & self.agree, live & ~self.agree)
        ]
        return counts[0], counts[1]

    def chance(self, errors: np.ndarray, log_det: np.ndarray) -> np.ndarray:
        """Bound on the chance that a false loop fits as well as this one does, (L,).

        The density N(ξ; 0, S) of a true loop over that of a false one, 1/V in the volume V of `false_reach`, is x or
        more for at most one of x false loops.
        """
        wide = min(self.config.noise_margin * self.scale, 1.0)
        log_density = -0.5 * (errors / wide + log_det + self.dof * np.log(2 * np.pi * wide))
        return np.exp(np.minimum(-log_density - self.log_space, 0.0))

    def find_limit(self, fit: np.ndarray) -> float:
        """Largest ξᵀ Ω ξ, of `fit` (L,) with the seed, with which a loop is kept."""
        wide = self.pair_gate
        if self.kept.sum() >= _MIN_FOR_NOISE:
            wide = max(wide, _TAIL * float(np.quantile(fit[self.kept], 0.99)))
        return min(wide, self.gate)

    def grow(self, reasons: list[str]) -> bool:
        """Adds loops that fit within the uncertainty of the way round; says of the others why not.

        Returns:
            Whether there were any.
        """
        rest = np.flatnonzero(~self.kept)
        if len(rest) == 0:
            return False
        errors, log_det = np.full((2, len(self.loops)), np.inf)
        errors[rest], log_det[rest] = self.pairs.detour_errors(rest, self.poses, np.flatnonzero(self.edges()))
        fits, chance = errors <= self.pair_gate, self.chance(errors, log_det)
        if len(self.poses) <= _SMALL:
            # What the way round leaves open, the whole graph may tell.
            unsure = np.flatnonzero(fits & (chance > self.config.max_chance))
            for loop in unsure[np.argsort(chance[unsure], kind="stable")][:_MAX_EXACT]:
                errors[loop], log_det[loop] = self.exact_error(loop)
            fits, chance = errors <= self.pair_gate, self.chance(errors, log_det)
        for loop in rest:
            if not fits[loop]:
                reasons[loop] = f"off by chi2 {errors[loop]:.3g} on the best way round, limit {self.pair_gate:.3g}"
            else:
                reasons[loop] = f"too uncertain: a false loop would pass with chance {chance[loop]:.2g}"
        ready = np.flatnonzero(fits & (chance <= self.config.max_chance))
        # The most certain first: with them the others get more certain.
        queue = [ready[np.argsort(chance[ready], kind="stable")]] if len(ready) else []
        if not queue and len(clique := self.clique(np.flatnonzero(fits))) > self.config.min_votes:
            queue = [clique]
        while queue and self.failures < self.max_failures:
            group = queue.pop(0)
            unfit = self.try_group(group, reasons)
            if unfit is None:
                return True  # with it in the graph, the others are judged anew
            if len(group) > 1:
                # The one that spoils it is most likely among those that fit least.
                parts = (group[~unfit], group[unfit]) if 0 < unfit.sum() < len(group) else np.array_split(group, 2)
                queue = [*parts, *queue]
        return False

    def exact_error(self, loop: int) -> tuple[float, float]:
        """ξᵀ S⁻¹ ξ and log det S of a loop with the covariance that all edges that count leave between its ends."""
        i, j = self.pairs.ends[loop]
        if self.marginals is None or self.marginals[0] is not self.poses:
            self.marginals = self.poses, self.factors.marginals(self.poses, np.flatnonzero(self.edges()))
        S = self.marginals[1](int(i), int(j)) + self.pairs.covariance[loop]
        S = S[np.ix_(self.pairs.used, self.pairs.used)]
        error = logarithm((inverse(self.pairs.Z[loop]) @ inverse(self.poses[i]) @ self.poses[j])[None])[0]
        xi = error[self.pairs.used]
        return float(xi @ np.linalg.solve(S, xi)), float(np.linalg.slogdet(S)[1])

    def clique(self, loops: np.ndarray) -> np.ndarray:
        """A large set of loops any two of which agree, by a greedy search from each."""
        loops = loops[:_MAX_CLIQUE_LOOPS]
        a, b = np.triu_indices(len(loops), 1)
        errors, _ = self.pairs.cycle_errors(loops[a], loops[b])
        agree = np.eye(len(loops), dtype=bool)
        agree[a, b] = agree[b, a] = errors <= self.pair_gate
        order = np.argsort(-agree.sum(axis=1), kind="stable")
        best: list[int] = []
        for first in order:
            members, open_ = [int(first)], agree[first].copy()
            for k in order:
                if k != first and open_[k]:
                    members.append(int(k))
                    open_ &= agree[k]
            best = max(best, members, key=len)
        return loops[np.array(best, int)]

    def try_group(self, group: np.ndarray, reasons: list[str]) -> np.ndarray | None:
        """Keeps a group of loops, indices, when the graph bends no more for it than its noise allows.

        The sum of squares grows by ξᵀ (Σ + P)⁻¹ ξ, with the exact covariance P of the graph between the ends.

        Returns:
            None when the group is kept; else which of it do not fit even with all of it in the graph, a mask.
        """
        before, kept, poses = self.fit_of_all().sum(), self.kept, self.poses
        self.kept = kept.copy()
        self.kept[group] = True
        starts = ("poses", "chordal") if len(poses) <= _SMALL else ("poses",)
        self.optimize(starts, _FEW_ITERATIONS if len(poses) > _SMALL else None)
        bend = self.fit_of_all().sum() - before
        limit = self.limit / self.gate * (self.gate + _LEFT_OVER * self.dof * (len(group) - 1))
        if bend <= limit:
            return None
        unfit = chi_squared(self.graph, self.poses)[self.loops[group]] > self.limit
        self.kept, self.poses = kept, poses
        self.failures += 1
        for loop in group:
            reasons[loop] = f"bends the graph by chi2 {bend:.3g}, limit {limit:.3g}"
        return unfit

    def fit_of_all(self) -> np.ndarray:
        """ξᵀ Ω ξ of the edges that count now."""
        return chi_squared(self.graph, self.poses)[self.edges()]
