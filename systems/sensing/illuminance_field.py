"""The illuminance between the points where it was measured, and how sure it is: a Gaussian process (row S4)."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from ..errors import ConfigError

_SQRT3 = np.sqrt(3.0)

Sight = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Which of the points (n, 2) [m] in the second argument are seen from those (m, 2) in the first, (m, n) bool."""


@dataclass(frozen=True, eq=False)
class IlluminanceField:
    """A Gaussian process through measured values, of which every place knows those that it sees. Read-only.

    The light behind a wall is another: what was measured there says nothing of the light here.

    Attributes:
        points: (n, 2) where was measured [m]. values: (n,) [lux].
        mean: of the values [lux]. amplitude: standard deviation of the field about it [lux].
        length: distance over which it changes [m]. noise: standard deviation of a value [lux].
        sight: what walls leave to be seen; everything, when not given.
    """

    points: np.ndarray
    values: np.ndarray
    mean: float
    amplitude: float
    length: float
    noise: float
    sight: Sight | None = None

    def __deepcopy__(self, memo: dict) -> "IlluminanceField":
        return self

    def at(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Expected illuminance at points (m, 2) [m] and its standard deviation, both (m,) [lux]; the mean and the
        amplitude where no measured point is seen."""
        points = np.asarray(points, float).reshape(-1, 2)
        return self._given(points, self._seen(points))

    def _seen(self, points: np.ndarray) -> np.ndarray:
        """Which measured points (n) are seen from points (m, 2), (m, n) bool."""
        return np.ones((len(points), len(self.points)), bool) if self.sight is None else self.sight(points, self.points)

    def _given(self, points: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation at points (m, 2), each given the measured points that `known` (m, n) says."""
        own = self._covariance()
        across = self.amplitude**2 * _matern(points, self.points, self.length)
        mean, variance = np.full(len(points), self.mean), np.full(len(points), self.amplitude**2)
        sets, which = np.unique(known, axis=0, return_inverse=True)
        for k, used in enumerate(sets):
            if not used.any():
                continue
            here = which.reshape(-1) == k
            factor = cho_factor(own[np.ix_(used, used)], lower=True)
            shared = across[np.ix_(here, used)]
            mean[here] += shared @ cho_solve(factor, self.values[used] - self.mean)
            variance[here] -= np.einsum("ij,ji->i", shared, cho_solve(factor, shared.T))
        return mean, np.sqrt(np.maximum(variance, 0.0))

    def _covariance(self) -> np.ndarray:
        own = self.amplitude**2 * _matern(self.points, self.points, self.length)
        covariance: np.ndarray = own + self.noise**2 * np.eye(len(self.points))
        return covariance

    def log_likelihood(self) -> float:
        """Log of the probability density of the values.

        Where walls hide points from each other, the product of the densities of every value given those before it that
        it sees (A. Vecchia, Estimation and model identification for continuous spatial processes, JRSS B 50, 1988).
        With everything in sight this is the joint density, which takes less time.
        """
        seen = self._seen(self.points)
        if not seen.all():
            mean, deviation = self._given(self.points, np.tril(seen, -1))
            variance = deviation**2 + self.noise**2
            return float(-0.5 * ((self.values - mean) ** 2 / variance + np.log(2 * np.pi * variance)).sum())
        factor = cho_factor(self._covariance(), lower=True)
        off = self.values - self.mean
        half_log_det = np.log(np.diag(factor[0])).sum()
        return float(-0.5 * off @ cho_solve(factor, off) - half_log_det - 0.5 * len(off) * np.log(2 * np.pi))


def fit_field(
    points: np.ndarray, values: np.ndarray, *, noise: float = 0.01, sight: Sight | None = None
) -> IlluminanceField:
    """The field whose amplitude and length make the values most likely, with the Matérn 3/2 covariance
    a² (1 + √3 r/l) exp(−√3 r/l) of points r apart.

    The length stays between half the smallest and twice the largest distance of two points, the amplitude between a
    fifth and five times the values' own deviation: few points say little about either.

    Args:
        points: (n, 2) [m]. values: (n,) [lux]. noise: standard deviation of a value, of the mean of all.
        sight: what walls leave to be seen, such as `FloorPlan.sight`; everything, when not given.

    Raises:
        ConfigError: there are fewer than three points, lengths differ, or a number is not finite.
    """
    points, values = np.asarray(points, float).reshape(-1, 2), np.asarray(values, float).reshape(-1)
    if len(points) != len(values) or len(points) < 3 or not (np.isfinite(points).all() and np.isfinite(values).all()):
        valid = "at least 3 finite points, a finite value each"
        raise ConfigError("no field", where="illuminance", key="points", value=len(points), valid=valid)
    distances = np.linalg.norm(points[:, None] - points, axis=2)[np.triu_indices(len(points), 1)]
    shortest, longest = max(distances.min(), 0.1), max(distances.max(), 0.2)
    mean, spread = float(values.mean()), max(float(values.std()), 1e-3 * abs(float(values.mean())), 1e-6)
    deviation = max(noise * abs(mean), 1e-3 * spread)

    def field(parameters: np.ndarray) -> IlluminanceField:
        amplitude, length = np.exp(parameters)
        return IlluminanceField(points, values, mean, float(amplitude), float(length), deviation, sight)

    bounds = [tuple(np.log([0.2 * spread, 5 * spread])), tuple(np.log([0.5 * shortest, 2 * longest]))]
    starts = [np.array([np.log(spread), np.log(length)]) for length in (shortest, np.sqrt(shortest * longest), longest)]
    found = [minimize(lambda p: -field(p).log_likelihood(), start, bounds=bounds) for start in starts]
    return field(min(found, key=lambda result: float(result.fun)).x)


def _matern(a: np.ndarray, b: np.ndarray, length: float) -> np.ndarray:
    scaled = _SQRT3 * np.linalg.norm(a[:, None] - b, axis=2) / length
    covariance: np.ndarray = (1 + scaled) * np.exp(-scaled)
    return covariance
