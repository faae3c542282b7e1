"""Where a scan lies in a map of which it is known only roughly where: an exhaustive search with bounds, compiled.

Olson, Real-time correlative scan matching, ICRA 2009: a coarse image whose pixels are the maximum over a window of the
fine one bounds the score of all shifts in the window from above. Windows are opened in the order of their bounds, until
the best score found is no lower than the next bound: the result is the best on the whole fine lattice.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.ndimage import maximum_filter

from ..config import quantity
from .likelihood_field import LikelihoodField


@dataclass(kw_only=True)
class CorrelativeSearchConfig:
    """How far is searched, and how finely."""

    # [m], [deg] Half the window around the expected pose.
    distance: float = quantity(3.0, unit="m", above=0)
    angle_deg: float = quantity(20.0, unit="deg", above=0)
    # [deg] Step of the angle. Shifts go in steps of a cell of the field.
    angle_step_deg: float = quantity(1.0, unit="deg", above=0)
    # [cells] Edge of a window.
    window: int = quantity(6, unit="cells", low=2)
    # [m] Deviation of the likelihood field.
    fit_deviation: float = quantity(0.1, unit="m", above=0)
    # [m], [-] Another pose, farther away than this, that scores as much of the best, is a rival: the place looks alike.
    rival_distance: float = quantity(0.5, unit="m", above=0)
    rival_score: float = quantity(0.92, unit="-", above=0, high=1)
    # [beams] As many of a scan are used, evenly.
    beams: int = quantity(120, unit="beams", low=10)


@dataclass(frozen=True, eq=False)
class SearchImage:
    """A likelihood field as an image to search in, and its bounds. Read-only.

    Attributes:
        fine: exp(-d² / (2 σ²)), (nx, ny) float32. coarse: maximum over the window from each cell on.
        origin: (2,) [m]. resolution: [m].
    """

    fine: np.ndarray
    coarse: np.ndarray
    origin: np.ndarray
    resolution: float


def make_search_image(field: LikelihoodField, config: CorrelativeSearchConfig) -> SearchImage:
    d = field.signed * field.resolution
    # Cells without a surface near are not likely at all, however far the field reaches.
    fine = np.where(np.abs(d) < 0.999 * field.reach, np.exp(-0.5 * np.square(d / config.fit_deviation)), 0)
    # With a border of a window, a window that begins outside the map does not lose what is inside.
    w = config.window
    fine = np.pad(fine.astype(np.float32), w)
    # The window of cell i is [i, i + w); the filter's own is centred.
    coarse = maximum_filter(fine, size=w, origin=-(w // 2), mode="constant")
    return SearchImage(fine, coarse, field.origin - w * field.resolution, field.resolution)


def correlative_search(
    image: SearchImage, points: np.ndarray, expected: np.ndarray, config: CorrelativeSearchConfig
) -> tuple[np.ndarray, float, np.ndarray]:
    """Best pose X_MB on the lattice around the `expected` one.

    Args:
        points: p_BP, where beams ended, (n, 2) [m].

    Returns:
        The pose (3,), its score, the mean likelihood, in [0, 1], and the shift (2,) [m] to a rival, zero without one.
    """
    if len(points) > config.beams:
        points = points[np.linspace(0, len(points) - 1, config.beams).astype(int)]
    steps = math.ceil(config.angle_deg / config.angle_step_deg)
    angles = expected[2] + math.radians(config.angle_step_deg) * np.arange(-steps, steps + 1)
    reach = math.ceil(config.distance / image.resolution)
    x, y, k, score, rival_x, rival_y = _search(
        image.fine, image.coarse, np.ascontiguousarray(points / image.resolution),
        (np.asarray(expected[:2]) - image.origin) / image.resolution, angles, reach, config.window,
        config.rival_distance / image.resolution, config.rival_score,
    )  # fmt: skip
    found = np.array([expected[0] + x * image.resolution, expected[1] + y * image.resolution, angles[k]])
    return found, score, np.array([rival_x - x, rival_y - y]) * image.resolution


@njit(cache=True)
def _score(image: np.ndarray, ij: np.ndarray, di: int, dj: int) -> float:
    total = 0.0
    for b in range(len(ij)):
        i, j = ij[b, 0] + di, ij[b, 1] + dj
        if 0 <= i < image.shape[0] and 0 <= j < image.shape[1]:
            total += image[i, j]
    return total


@njit(cache=True)
def _search(
    fine: np.ndarray,
    coarse: np.ndarray,
    points: np.ndarray,
    centre: np.ndarray,
    angles: np.ndarray,
    reach: int,
    window: int,
    apart: float,
    alike: float,
) -> tuple[int, int, int, float, int, int]:
    """Shift (x, y), index of the angle and score of the best, shift of its rival or the same; all lengths in cells."""
    count = len(points)
    cells = np.empty((len(angles), count, 2), np.int64)
    for k in range(len(angles)):
        c, s = math.cos(angles[k]), math.sin(angles[k])
        for b in range(count):
            cells[k, b, 0] = math.floor(centre[0] + c * points[b, 0] - s * points[b, 1])
            cells[k, b, 1] = math.floor(centre[1] + s * points[b, 0] + c * points[b, 1])
    across = (2 * reach) // window + 1
    bounds = np.empty(len(angles) * across * across)
    for k in range(len(angles)):
        for p in range(across):
            for q in range(across):
                at = (k * across + p) * across + q
                bounds[at] = _score(coarse, cells[k], p * window - reach, q * window - reach)
    order = np.argsort(-bounds)
    best, best_x, best_y, best_k = -1.0, 0, 0, 0
    for n in range(len(order)):
        at = int(order[n])
        if bounds[at] <= best:
            break
        k, p, q = at // (across * across), (at // across) % across, at % across
        for x in range(p * window - reach, (p + 1) * window - reach):
            for y in range(q * window - reach, (q + 1) * window - reach):
                score = _score(fine, cells[k], x, y)
                if score > best:
                    best, best_x, best_y, best_k = score, x, y, k
    for n in range(len(order)):
        at = int(order[n])
        if bounds[at] < alike * best:
            break
        k, p, q = at // (across * across), (at // across) % across, at % across
        for x in range(p * window - reach, (p + 1) * window - reach):
            for y in range(q * window - reach, (q + 1) * window - reach):
                if (x - best_x) ** 2 + (y - best_y) ** 2 > apart**2 and _score(fine, cells[k], x, y) >= alike * best:
                    return best_x, best_y, best_k, best / max(count, 1), x, y
    return best_x, best_y, best_k, best / max(count, 1), best_x, best_y
