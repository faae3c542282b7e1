"""Levels of a channel: where its histogram has valleys, and how probable each level is for a value."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.special import expit, ndtr

# The valley must be at most this share of the lower of the peaks beside it.
_VALLEY = 0.5
# A population must hold this many values and this share of all: what is told apart may be rare, but it is no stray.
_MIN_VALUES, _MIN_SHARE = 20, 0.003
# Values below this share of the median are as dark as that: below is noise, which logarithms would spread.
_BLACK = 0.03
# Smoothing of the histogram, times the fifth root of the number of values, as a share of its width.
_SMOOTHING = 0.19
_MANY = 50_000
# No label is surer than this: pixels on edges, wet spots.
_MIN_ERROR = 0.01


@dataclass(frozen=True)
class Levels:
    """Up to three levels of a channel: dark, usual and bright. A level without a threshold is never taken.

    Attributes:
        dark, bright: thresholds to the usual level; -inf and inf where there is none, NaN when nothing is known.
        widths: of the change at both thresholds, of the logistic function of the value (of its log, with `log`).
        errors: share of wrong labels beside each threshold, from how far the populations overlap.
        weak: there was no valley: the threshold only halves the values as Otsu does.
        log: it is the logarithm of values that is compared.
    """

    dark: float = np.nan
    bright: float = np.nan
    widths: tuple[float, float] = (1.0, 1.0)
    errors: tuple[float, float] = (_MIN_ERROR, _MIN_ERROR)
    weak: bool = True
    log: bool = True

    def probabilities(self, values: np.ndarray) -> np.ndarray:
        """Probabilities of dark, usual and bright for values (N,), (N, 3); NaN where unknown."""
        values = np.asarray(values, float)
        result = np.full((len(values), 3), np.nan)
        known = np.isfinite(values) & ~np.isnan(self.dark)
        at = _scale(values[known], self.log)
        above = np.ones((2, len(at)))
        for i, threshold in enumerate((self.dark, self.bright)):
            if np.isinf(threshold):
                above[i] = float(threshold < 0)
            else:
                sure = expit((at - _scale(np.array(threshold), self.log)) / self.widths[i])
                above[i] = self.errors[i] + (1 - 2 * self.errors[i]) * sure
        above[1] *= above[0]
        result[known] = np.column_stack([1 - above[0], above[0] - above[1], above[1]])
        return result


def find_levels(histogram: np.ndarray, edges: np.ndarray, *, log: bool = True, bright: bool = True) -> Levels:
    """Chooses thresholds in the deepest valleys of a histogram, on both sides of its highest peak.

    Logarithms, because illumination and distance multiply; valleys, because Otsu's threshold cuts into the larger of
    two populations of very different size. A valley must be at most half as high as the peaks on its sides, with at
    least 20 values and 0.3 % of all beyond it. Water is dark and signs send light straight back, so intensity has up to
    two valleys. Without any, the values are halved as Otsu does and the result is weak: the labels are then soft,
    because the halves overlap.

    Args:
        histogram: (n,) counts. edges: (n + 1,).
        bright: look for a bright level; else the deepest valley on either side divides dark from usual.
    """
    total = float(histogram.sum())
    if total < 2 * _MIN_VALUES:
        return Levels()
    x = 0.5 * (_scale(edges[1:], log) + _scale(edges[:-1], log))
    counts = histogram.astype(float).copy()
    risen = np.cumsum(counts)
    if log:
        black = int(np.searchsorted(x, x[np.searchsorted(risen, 0.5 * total)] + np.log(_BLACK)))
        counts[black] += counts[:black].sum()
        counts[:black] = 0
        risen = np.cumsum(counts)
    first, last = np.searchsorted(risen, [0.0005 * total, 0.9995 * total])
    if last - first < 3:
        return Levels(-np.inf, np.inf, log=log)
    sigma = max(_SMOOTHING * (last - first + 1) * min(total, _MANY) ** -0.2, 0.5)
    density = gaussian_filter1d(counts, sigma, mode="constant")
    top = int(density.argmax())
    beyond = {-1: risen, 1: total - risen}
    found: dict[int, tuple[int, float]] = {}
    for side in (-1, 1):
        path = np.arange(top, first - 1 if side < 0 else last + 1, side)
        peak = np.minimum(density[top], np.maximum.accumulate(density[path][::-1])[::-1])
        enough = beyond[side][path] >= max(_MIN_VALUES, _MIN_SHARE * total)
        depth = np.where(enough & (density[path] <= _VALLEY * peak), 1 - density[path] / peak, -np.inf)
        if np.isfinite(depth.max(initial=-np.inf)):
            flat = np.flatnonzero(depth >= depth.max() - 0.02)
            run = flat[: 1 + int(np.argmax(np.diff(flat, append=flat[-1] + 2) > 1))]  # the first of equal valleys
            found[side] = int(path[run[len(run) // 2]]), float(depth.max())
    if not bright and len(found) == 2:
        found = dict([max(found.items(), key=lambda item: item[1][1])])
    if not found:
        return _levels({-1: _otsu(counts, x)}, counts, x, weak=True, log=log)
    places = {side: place for side, (place, _) in found.items()}
    if not bright:
        places = {-1: next(iter(places.values()))}
    return _levels(places, counts, x, weak=False, log=log)


def _levels(places: dict[int, int], counts: np.ndarray, x: np.ndarray, *, weak: bool, log: bool) -> Levels:
    """Levels with thresholds at these bins, softened as far as the populations on both sides overlap."""
    thresholds, widths, errors = [-np.inf, np.inf], [1.0, 1.0], [_MIN_ERROR, _MIN_ERROR]
    bounds = [0, *sorted(place + 1 for place in places.values()), len(x)]
    for i, side in enumerate((-1, 1)):
        if side not in places:
            continue
        cut = places[side] + 1
        at = bounds.index(cut)
        threshold = 0.5 * (x[cut - 1] + x[cut])
        low, high = (_moments(counts[part], x[part]) for part in _parts(bounds, at))
        slope = (threshold - low[0]) / low[1] ** 2 + (high[0] - threshold) / high[1] ** 2
        widths[i] = 1 / max(slope, 1e-6)
        tails = ndtr(-(threshold - low[0]) / low[1]), ndtr(-(high[0] - threshold) / high[1])
        errors[i] = float(np.clip(max(tails), _MIN_ERROR, 0.45 if weak else 0.25))
        thresholds[i] = float(np.exp(threshold) if log else threshold)
    return Levels(thresholds[0], thresholds[1], (widths[0], widths[1]), (errors[0], errors[1]), weak, log)


def _parts(bounds: list[int], at: int) -> tuple[slice, slice]:
    return slice(bounds[at - 1], bounds[at]), slice(bounds[at], bounds[at + 1])


def _moments(counts: np.ndarray, x: np.ndarray) -> tuple[float, float]:
    weight = max(float(counts.sum()), 1e-12)
    mean = float(counts @ x) / weight
    return mean, max(float(np.sqrt(counts @ (x - mean) ** 2 / weight)), 1e-3)


def _otsu(counts: np.ndarray, x: np.ndarray) -> int:
    """Bin after which the variance between both sides is largest."""
    below = np.cumsum(counts)
    sums = np.cumsum(counts * x)
    with np.errstate(divide="ignore", invalid="ignore"):
        between = (sums[-1] * below / below[-1] - sums) ** 2 / (below * (below[-1] - below))
    return int(np.nanargmax(np.where(np.isfinite(between), between, -1.0)))


def _scale(values: np.ndarray, log: bool) -> np.ndarray:
    return np.log(np.maximum(values, 1e-12)) if log else values
