"""Dark against bright: where the brightness of surfaces falls into two populations."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

_BINS = 64
# Bins over which the histogram is smoothed, times the fifth root of the number of values, as for a density estimate.
_SMOOTHING = 12.0
# The dark population must hold this many values and this share of all, and the bright one this share: what is dark may
# be rare, but a few glaring spots do not make everything else dark.
_MIN_VALUES, _MIN_DARK, _MIN_BRIGHT = 20, 0.003, 0.05
# The valley must be at most this share of the lower peak.
_VALLEY = 0.5
# What is darker than this share of the median is as dark as that: below is noise, which logarithms would spread.
_BLACK = 0.03


@dataclass(frozen=True)
class Threshold:
    """A value that separates dark from bright.

    Attributes:
        value: dark is below it; NaN where there was no value to choose it from.
        valley: there are two populations, and it lies in the valley between them; else it is a share of the median.
    """

    value: float
    valley: bool


def dark_threshold(values: np.ndarray, *, share: float = 0.4) -> Threshold:
    """Chooses the threshold between dark and bright from the values themselves.

    Takes the deepest valley of the smoothed histogram of log brightness. Logarithms, because illumination and
    distance multiply; a valley, because Otsu's threshold cuts into the larger of two populations of very different
    size, and cuts a single one in half. The valley must be at most half as high as the lower of the peaks on its
    sides, with at least 20 values and 0.3 % of all below it and 5 % above. Where there is none, everything is of one
    kind, and the threshold is `share` of the median: what is that much darker than usual is dark. Whole numbers are
    spread over the steps between them, or the steps would be valleys.

    Args:
        values: brightness of any shape and scale, not negative; what is not finite is left out.
    """
    known = np.asarray(values, float).ravel()
    known = known[np.isfinite(known)]
    median = float(np.median(known)) if len(known) else np.nan
    if not median > 0:
        return Threshold(median, False)
    fallback = Threshold(share * median, False)
    logs = np.log(np.maximum(known, _BLACK * median))
    steps, count = np.unique(logs, return_counts=True)
    if len(known) < 2 * _MIN_VALUES or np.ptp(np.percentile(logs, [0.1, 99.9])) < 1e-3:
        return fallback
    # Between the middles of its neighbours every value is spread evenly: the distribution rises from middle to middle.
    middles = 0.5 * (steps[1:] + steps[:-1])
    middles = np.concatenate([[2 * steps[0] - middles[0]], middles, [2 * steps[-1] - middles[-1]]])
    risen = np.concatenate([[0], np.cumsum(count)])
    low, high = np.interp([0.001 * len(known), 0.999 * len(known)], risen, middles)
    edges = np.linspace(low, high, _BINS + 1)
    below_edge = np.interp(edges, middles, risen)
    histogram = np.diff(below_edge)
    density = gaussian_filter1d(histogram, _SMOOTHING * len(known) ** -0.2, mode="constant")
    left, right = np.maximum.accumulate(density), np.maximum.accumulate(density[::-1])[::-1]
    peak = np.minimum(left, right)
    below = 0.5 * (below_edge[1:] + below_edge[:-1])
    valid = (density <= _VALLEY * peak) & (below >= max(_MIN_VALUES, _MIN_DARK * len(known)))
    valid &= len(known) - below >= max(_MIN_VALUES, _MIN_BRIGHT * len(known))
    if not valid.any():
        return fallback
    deepest = int(np.argmax(np.where(valid, peak - density, -np.inf)))
    # The bottom may be flat: its middle.
    flat = density <= density[deepest] + 0.05 * peak[deepest]
    first = last = deepest
    while first > 0 and flat[first - 1]:
        first -= 1
    while last < _BINS - 1 and flat[last + 1]:
        last += 1
    return Threshold(float(np.exp(0.5 * (edges[first] + edges[last + 1]))), True)
