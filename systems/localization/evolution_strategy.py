"""Search for the pose at which a scan fits a map, by evolution: ours and that of the paper."""

from dataclasses import dataclass

import numpy as np

from ..config import quantity
from ..noise import generator_at
from .evolution_kernels import evolve_mu_plus_lambda, evolve_mu_plus_one
from .likelihood_field import LikelihoodField
from .occupancy_grid import OccupancyGrid


@dataclass(kw_only=True)
class EvolutionConfig:
    """Sizes of the populations. Those of the paper are not stated there."""

    # [individuals], [generations] Of our (μ + λ)-ES.
    parents: int = quantity(8, unit="individuals", low=2)
    children: int = quantity(40, unit="individuals", low=2)
    generations: int = quantity(8, unit="generations", low=1)
    # [m] Deviation of the likelihood field: how far a beam may end from a wall and still count. Wide, for a wide basin.
    fit_deviation: float = quantity(0.1, unit="m", above=0)
    # [individuals], [generations] Of the (μ + 1)-ES of the paper.
    paper_parents: int = quantity(100, unit="individuals", low=2)
    paper_generations: int = quantity(1000, unit="generations", low=1)


def evolve(
    field: LikelihoodField,
    points: np.ndarray,
    prior: np.ndarray,
    spread: np.ndarray,
    information: np.ndarray,
    weight: float,
    config: EvolutionConfig,
    *,
    seed: int,
    index: int,
) -> np.ndarray:
    """Pose X_MB (3,) at which `points` p_BP (n, 2) [m] fit best, by a (μ + λ)-ES around `prior` (3,).

    Args:
        spread: deviation of the first generation (3,) [m, m, rad].
        information: of the prior (3, 3); what is made largest is weight · fitness - ½ eᵀ Ω e.
        seed, index: of the randomness; the same give the same.
    """
    rng = generator_at(seed, index)
    normals = rng.standard_normal((config.generations + 1, config.children, 3))
    uniforms = rng.random((config.generations, config.children, 2))
    return evolve_mu_plus_lambda(
        field.signed, field.origin[0], field.origin[1], field.resolution, field.reach / field.resolution, points,
        prior, spread, information, weight, config.fit_deviation, normals, uniforms, config.parents,
    )  # fmt: skip


def evolve_as_paper(
    grid: OccupancyGrid,
    points: np.ndarray,
    start: np.ndarray,
    spread: np.ndarray,
    config: EvolutionConfig,
    *,
    seed: int,
    index: int,
) -> tuple[np.ndarray, float, np.ndarray]:
    """Pose, fitness and the spread of the last population, by the evolution strategy that the paper names.

    Inoue et al. estimate the pose by "SLAM based on a two-dimensional evolution strategy" (their reference 3) and show
    a fitness between 0 and 1, high where the scan lies on the map. The operators are not in the paper; here are those
    that its authors use elsewhere, a (μ + 1)-ES with elitist crossover and adaptive mutation, and as fitness the share
    of beams that end in occupied cells. There is no prior and no refinement.

    Args:
        spread: deviation of the first generation (3,) [m, m, rad].

    Returns:
        X_MB (3,), fitness in [0, 1], covariance of the last population (3, 3).
    """
    rng = generator_at(seed, index)
    total = config.paper_parents + config.paper_generations
    pose, fitness, pool = evolve_mu_plus_one(
        grid.log_odds, grid.origin[0], grid.origin[1], grid.resolution, points, start, spread, 0.05 * spread,
        rng.standard_normal((total, 3)), rng.random((config.paper_generations, 4)),
    )  # fmt: skip
    return pose, float(fitness), np.cov(pool.T)
