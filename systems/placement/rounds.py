"""Rounds of evolution and verification: few landmarks are tried, failures say where more is needed (S4-e)."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from ..config import check_config, quantity
from ..errors import ConfigError
from .evolution_config import EvolutionConfig
from .evolve import Placement, evolve
from .floor_plan import FloorPlan
from .problem import PlacementProblem


@dataclass(frozen=True, eq=False)
class Verification:
    """What the run of a placement has shown, in physics or wherever it was tried. Read-only.

    Attributes:
        ok: whether the robot knew its place well enough all the way.
        max_error: largest error of its position that was seen [m].
        where: (2,) true place where the error became too large in W [m]; None when it was not the error that failed.
        why: in words, "" when it was ok.
        limit: error with which it fails [m]; None when that is the error that the problem allows.
    """

    ok: bool
    max_error: float
    where: np.ndarray | None = None
    why: str = ""
    limit: float | None = None

    def __deepcopy__(self, memo: dict) -> "Verification":
        return self


Verify = Callable[[FloorPlan, Placement, np.ndarray], Verification]
"""Runs a placement with boxes at sites (m, 2) in a plan."""


@dataclass(kw_only=True)
class RoundsConfig:
    """How few landmarks are tried in turn, and what a failure changes."""

    # [-] Least share of the sites that get a landmark, by round.
    shares: list[float] = quantity([0.75, 0.5, 0.25, 0.0], low=0, high=1, min_length=1)
    # Failures that are learnt from, for each share.
    retries: int = quantity(6, unit="rounds", low=0)
    # [m] Around the place of a failure within which the error must be smaller from then on.
    radius: float = quantity(6.0, unit="m", above=0)
    # [-] Least and most of the error that was expected there that is then allowed: between them, what the run
    # allowed over what was measured.
    tighten: list[float] = quantity([0.5, 0.8], low=0.01, high=0.99, min_length=2)
    # [-] Preset "paper": from nodes there landmarks count no farther than this share of before, and a side without one
    # costs so much more.
    shrink: float = quantity(0.5, above=0, high=1)
    penalty: float = quantity(2.0, low=0)
    evolution: EvolutionConfig = field(default_factory=EvolutionConfig)


@dataclass(frozen=True, eq=False)
class Round:
    """One evolution and its run. Read-only.

    Attributes:
        least: lower bound of the number of landmarks.
        placement, verification: what came out, and how it did.
    """

    least: int
    placement: Placement
    verification: Verification

    def __deepcopy__(self, memo: dict) -> "Round":
        return self


@dataclass(frozen=True, eq=False)
class Rounds:
    """All rounds in turn. Read-only.

    Attributes:
        rounds: one after the other.
        problem: with what the failures have taught.
    """

    rounds: tuple[Round, ...]
    problem: PlacementProblem

    def __deepcopy__(self, memo: dict) -> "Rounds":
        return self

    @property
    def best(self) -> Round | None:
        """The round that went well with the fewest landmarks, of those the shortest; None when none did."""
        good = [r for r in self.rounds if r.verification.ok]
        return min(good, key=lambda r: (r.placement.chosen.sum(), r.placement.length), default=None)

    @property
    def landmarks(self) -> list[int]:
        """Number of landmarks by round."""
        return [int(r.placement.chosen.sum()) for r in self.rounds]


def run_rounds(
    problem: PlacementProblem,
    verify: Verify,
    config: RoundsConfig | None = None,
    *,
    map_: Callable[..., Iterable[Verification]] = map,
    report: Callable[[Round], None] | None = None,
) -> Rounds:
    """Evolves with falling lower bounds of the number of landmarks, and has every result verified (S4-e).

    Each evolution goes on from the populations of the one before. The rounds that come before any failure do not depend
    on each other's runs, so that `map_` may run them in parallel. What fails is evolved again with that bound, by a
    problem that asks for more where it failed (`learn_from`), `retries` times at most.

    Args:
        verify: called with the plan, a placement and the places of its boxes, once for each placement.
        map_: as the built-in, with `verify` and three sequences.
        report: called after every round.

    Raises:
        ConfigError: a value of `config` is out of range.
    """
    config = config or RoundsConfig()
    check_config(config, key="rounds")
    if len(config.tighten) != 2 or config.tighten[0] > config.tighten[1]:
        raise ConfigError("wrong length or order", key="rounds.tighten", value=config.tighten, valid="least, most")
    pending = [round(share * len(problem.sites)) for share in config.shares]
    rounds: list[Round] = []
    driven: dict[tuple[bytes, ...], Verification] = {}
    before = None
    for attempt in range(config.retries + 1):
        evolution = replace(config.evolution, seed=config.evolution.seed + attempt)
        placements = []
        for least in pending:
            before = evolve(problem, evolution, least=least, before=before)
            placements.append(before)
        # Two bounds may give one placement, and a later attempt an earlier one.
        new = {_what_is_driven(p): p for p in placements if _what_is_driven(p) not in driven}
        runs = iter(map_(verify, [problem.plan] * len(new), new.values(), [p.sites for p in new.values()]))
        failed, learnt = [], set()
        for least, placement in zip(pending, placements, strict=True):
            what = _what_is_driven(placement)
            seen = driven[what] if what in driven else driven.setdefault(what, next(runs))
            rounds.append(Round(least, placement, seen))
            if report is not None:
                report(rounds[-1])
            if not seen.ok:
                failed.append(least)
                # Two bounds that gave one placement failed once.
                if what not in learnt:
                    learnt.add(what)
                    problem = learn_from(problem, placement, seen, config)
        if not failed:
            break
        pending = failed
    return Rounds(tuple(rounds), problem)


def _what_is_driven(placement: Placement) -> tuple[bytes, ...]:
    """Equal for placements that are the same to drive."""
    return placement.order.tobytes(), placement.route.tobytes(), placement.sites.tobytes()


def learn_from(
    problem: PlacementProblem, placement: Placement, seen: Verification, config: RoundsConfig
) -> PlacementProblem:
    """The problem after a failure: within `radius` of it less error is allowed than was expected of the placement
    there, everywhere when it is not known where it was. So that placement is within the limit no more. As the paper
    counts, landmarks must be nearer there."""
    poses, errors = problem.errors_along(placement.order, placement.chosen)
    allowed = problem.config.error_limit if seen.limit is None else seen.limit
    least, most = config.tighten
    share = min(max(allowed / max(seen.max_error, 1e-9), least), most)
    near_pose, near_node = np.ones(len(problem.poses), bool), np.ones(len(problem.sight.places), bool)
    expected = errors.max()
    if seen.where is not None:
        gap = np.hypot(*(poses[:, :2] - seen.where).T)
        # At the nearest pose of the route, however far the robot was off it.
        radius = max(config.radius, float(gap.min()) + 1e-9)
        expected = errors[gap <= radius].max()
        near_pose = np.hypot(*(problem.poses[:, :2] - seen.where).T) <= radius
        near_node = np.hypot(*(problem.sight.places - seen.where).T) <= radius
    limit = np.where(near_pose, np.minimum(problem.limit, share * expected), problem.limit)
    return replace(problem, limit=limit, sight=problem.sight.harder(near_node, config.shrink, config.penalty))
