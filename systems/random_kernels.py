"""Random numbers for compiled loops, in a fraction of the time that it takes to compile numpy's generators."""

import numpy as np
from numba import njit

_UNIT = 2.0**-53


def seeded(seed: int) -> np.ndarray:
    """(1,) uint64: a state for `draw` and `uniform`, never 0."""
    return np.random.default_rng(seed).integers(1, 2**63, 1, np.uint64)


@njit(cache=True)
def next_random(rng: np.ndarray) -> int:
    """The next 64 bits of xorshift64* (Vigna 2016); the lowest are weak. rng: (1,) uint64, not 0."""
    x = rng[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    rng[0] = x
    return x * np.uint64(2685821657736338717)


@njit(cache=True)
def unit_share(bits: int) -> float:
    """The number in [0, 1) that 64 random bits stand for."""
    return float(bits >> np.uint64(11)) * _UNIT


@njit(cache=True)
def uniform(rng: np.ndarray) -> float:
    """A random number in [0, 1)."""
    return unit_share(next_random(rng))


@njit(cache=True)
def draw(rng: np.ndarray, n: int) -> int:
    """A random integer from 0 to n - 1."""
    return int(uniform(rng) * n)


@njit(cache=True)
def shuffled(rng: np.ndarray, n: int) -> np.ndarray:
    """(n,) the integers from 0 to n - 1 in random order."""
    order = np.arange(n)
    for k in range(n - 1, 0, -1):
        j = draw(rng, k + 1)
        order[k], order[j] = order[j], order[k]
    return order
