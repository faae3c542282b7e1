"""Compiled evolution strategies on the pose X_MB of a scan; arguments as in `match_kernels`."""

import math

import numpy as np
from numba import njit

from .match_kernels import likelihood_fitness
from .planar import difference


@njit(cache=True)
def hit_share(log_odds: np.ndarray, ox: float, oy: float, res: float, points: np.ndarray, X: np.ndarray) -> float:
    """Share of the beams' ends in cells of walls' faces; in [0, 1].

    What is occupied all around is the inside of a wall: no beam ends there. Ends in cells that are not known are not
    left out: while the map is made, a pose from which most beams end beyond it would be the fittest.
    """
    c, s = math.cos(X[2]), math.sin(X[2])
    hit = 0
    for k in range(len(points)):
        i = math.floor((X[0] + c * points[k, 0] - s * points[k, 1] - ox) / res)
        j = math.floor((X[1] + s * points[k, 0] + c * points[k, 1] - oy) / res)
        if 0 <= i < log_odds.shape[0] and 0 <= j < log_odds.shape[1]:
            hit += log_odds[i, j] > 0.0 and not _is_inside(log_odds, i, j)
    return hit / max(len(points), 1)


@njit(cache=True)
def _is_inside(log_odds: np.ndarray, i: int, j: int) -> bool:
    for p, q in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)):
        if 0 <= p < log_odds.shape[0] and 0 <= q < log_odds.shape[1] and log_odds[p, q] <= 0.0:
            return False
    return True


@njit(cache=True)
def evolve_mu_plus_lambda(
    signed: np.ndarray,
    ox: float,
    oy: float,
    res: float,
    reach: float,
    points: np.ndarray,
    prior: np.ndarray,
    spread: np.ndarray,
    information: np.ndarray,
    weight: float,
    sigma: float,
    normals: np.ndarray,
    uniforms: np.ndarray,
    parents: int,
) -> np.ndarray:
    """Best pose of a (μ + λ)-ES around `prior`, (3,).

    Children are the mean of two parents with a mutation of deviation step · `spread`; the step grows by 1.2 where more
    than a fifth of the children beat the worst parent, and shrinks by 0.7 where fewer do. The prior itself is in the
    first generation. What is maximised is `weight` · fitness - ½ eᵀ Ω e, e the distance from the prior.

    Args:
        spread: (3,), deviation of the first generation. information: Ω, (3, 3).
        normals: (generations + 1, λ, 3) and uniforms: (generations, λ, 2), the randomness.
    """
    generations, children = uniforms.shape[0], normals.shape[1]
    pool = np.empty((parents + children, 3))
    score = np.full(parents + children, -np.inf)
    for k in range(children):
        pool[parents + k] = prior + (spread * normals[0, k] if k > 0 else np.zeros(3))
        score[parents + k] = _posterior(
            signed, ox, oy, res, reach, points, pool[parents + k], prior, information, weight, sigma
        )
    order = np.argsort(-score)[:parents]
    pool[:parents], score[:parents] = pool[order].copy(), score[order].copy()
    step = 0.5
    for g in range(generations):
        better, worst = 0, score[parents - 1]
        for k in range(children):
            a, b = int(uniforms[g, k, 0] * parents), int(uniforms[g, k, 1] * parents)
            child = pool[a] + 0.5 * difference(pool[a], pool[b]) + step * spread * normals[g + 1, k]
            pool[parents + k] = child
            score[parents + k] = _posterior(
                signed, ox, oy, res, reach, points, child, prior, information, weight, sigma
            )
            better += score[parents + k] > worst
        order = np.argsort(-score)[:parents]
        pool[:parents], score[:parents] = pool[order].copy(), score[order].copy()
        step *= 1.2 if 5 * better > children else 0.7
    return pool[0]


@njit(cache=True)
def _posterior(
    signed: np.ndarray,
    ox: float,
    oy: float,
    res: float,
    reach: float,
    points: np.ndarray,
    X: np.ndarray,
    prior: np.ndarray,
    information: np.ndarray,
    weight: float,
    sigma: float,
) -> float:
    e = difference(prior, X)
    far = 0.0
    for a in range(3):
        for b in range(3):
            far += e[a] * information[a, b] * e[b]
    return weight * likelihood_fitness(signed, ox, oy, res, reach, points, X, sigma) - 0.5 * far


@njit(cache=True)
def evolve_mu_plus_one(
    log_odds: np.ndarray,
    ox: float,
    oy: float,
    res: float,
    points: np.ndarray,
    start: np.ndarray,
    deviation: np.ndarray,
    least: np.ndarray,
    normals: np.ndarray,
    uniforms: np.ndarray,
) -> tuple[np.ndarray, float, np.ndarray]:
    """Best pose of a (μ + 1)-ES with elitist crossover and adaptive mutation, its fitness, and the last population.

    Every generation one child takes each number from the best or from a random individual; the number is mutated by
    (α (f_max - f) / (f_max - f_min) + β) N(0, 1), f the fitness of that individual; the child replaces the worst where
    it is fitter. Fitness is `hit_share`.

    Args:
        deviation: α and deviation of the first generation, (3,). least: β, (3,).
        normals: (μ + generations, 3). uniforms: (generations, 4).
    """
    generations = len(uniforms)
    count = len(normals) - generations
    pool, score = np.empty((count, 3)), np.empty(count)
    for k in range(count):
        pool[k] = start + (deviation * normals[k] if k > 0 else np.zeros(3))
        score[k] = hit_share(log_odds, ox, oy, res, points, pool[k])
    for g in range(generations):
        best, worst = int(score.argmax()), int(score.argmin())
        other = int(uniforms[g, 0] * count)
        part = (score[best] - score[other]) / max(score[best] - score[worst], 1e-9)
        child = np.empty(3)
        for h in range(3):
            base = pool[best, h] if uniforms[g, 1 + h] < 0.5 else pool[other, h]
            child[h] = base + (deviation[h] * part + least[h]) * normals[count + g, h]
        fitness = hit_share(log_odds, ox, oy, res, points, child)
        if fitness > score[worst]:
            pool[worst], score[worst] = child, fitness
    best = int(score.argmax())
    return pool[best], score[best], pool
