"""How routes and landmarks evolve."""

from dataclasses import dataclass

from ..config import quantity


@dataclass(kw_only=True)
class EvolutionConfig:
    """Which co-evolution, how large, and what lengths and errors are worth to it."""

    # "ours": expected error along the route and local search; "paper": operators and fitness as published.
    preset: str = quantity("ours", choices=("ours", "paper"))
    # Individuals of both populations, at least two.
    routes: int = quantity(20, unit="routes", low=2)
    sets: int = quantity(20, unit="sets", low=2)
    # Generations at most, and those without a better one after which it ends.
    generations: int = quantity(200, unit="generations", low=1)
    patience: int = quantity(40, unit="generations", low=1)
    # [-] Probability that one random site of a child is flipped.
    flip: float = quantity(0.3, low=0, high=1)
    # [m] Route that a landmark is worth (ours): what a robot drives in the time that somebody needs to put up a box.
    landmark_worth: float = quantity(40.0, unit="m", above=0)
    # [m] Route that the mean error is worth, in units of the limit: enough to choose between equals.
    calm_worth: float = quantity(5.0, unit="m", low=0)
    # [m] Longest route; null for no limit.
    longest: float | None = quantity(None, unit="m", above=0)
    # The same seed gives the same result.
    seed: int = quantity(0, low=0)
