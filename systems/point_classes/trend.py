"""How a channel depends on range, so that this does not become classes."""

from dataclasses import dataclass

import numpy as np

from .class_counts import RANGE_CENTRES

# A bin of range needs this many values to count.
_ENOUGH = 100
_FLAT = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class RangeTrend:
    """Usual logarithm of a channel by range: a parabola in the logarithm of the range, level where it is not known.

    Attributes:
        coefficients: of (log r)², log r and 1, less the mean of the channel; zero when it does not depend on range.
        low, high: ranges between which it was found [m].
    """

    coefficients: tuple[float, float, float] = _FLAT
    low: float = 1.0
    high: float = 1.0

    def factor(self, ranges: np.ndarray) -> np.ndarray:
        """By how much values at `ranges` (N,) [m] are usually larger than they are on average, (N,)."""
        if self.coefficients == _FLAT:
            return np.ones(np.shape(ranges))
        x = np.log(np.clip(ranges, self.low, self.high))
        return np.exp(np.polyval(self.coefficients, x))


def find_trend(histograms: np.ndarray, edges: np.ndarray) -> RangeTrend:
    """The trend of the medians of `histograms` (range bins, bins) with logarithmic `edges` (bins + 1,).

    Reflectivities of real sensors rise with range by a factor of 20 between 2 m and 40 m, partly because only what is
    bright comes back from afar. What is darker or brighter than usual at its range stands out whatever its range.
    """
    counts = histograms.sum(axis=1)
    rows = np.flatnonzero(counts >= _ENOUGH)
    if len(rows) < 3:
        return RangeTrend()
    centres = 0.5 * (np.log(edges[1:]) + np.log(edges[:-1]))
    risen = np.cumsum(histograms[rows], axis=1)
    medians = centres[(risen < 0.5 * counts[rows, None]).sum(axis=1)]
    x = np.log(RANGE_CENTRES[rows])
    fit = np.polyfit(x, medians, 2 if len(rows) > 3 else 1, w=np.sqrt(counts[rows]))
    fit = np.concatenate([np.zeros(3 - len(fit)), fit])
    fit[2] -= np.average(np.polyval(fit, x), weights=counts[rows])
    return RangeTrend(tuple(map(float, fit)), float(RANGE_CENTRES[rows[0]]), float(RANGE_CENTRES[rows[-1]]))  # type: ignore[arg-type]


def without_trend(histograms: np.ndarray, edges: np.ndarray, trend: RangeTrend) -> np.ndarray:
    """Histogram over all ranges of values divided by the trend, (bins,)."""
    if trend.coefficients == _FLAT:
        return histograms.sum(axis=0)
    x = np.log(edges)
    total = np.zeros(histograms.shape[1])
    for row, shift in zip(histograms, np.log(trend.factor(RANGE_CENTRES)), strict=True):
        if row.any():
            risen = np.concatenate([[0], np.cumsum(row)])
            total += np.diff(np.interp(x + shift, x, risen))
    return total
