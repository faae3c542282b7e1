"""The floor under a scan, and with it which way is up."""

import numpy as np
from numba import njit

# Triples of points of which a plane is made, and planes that are tried on the points.
TRIPLES = 3000
# Planes with most votes that are fitted to all points.
FITTED = 8
# [m] Edge of the squares of which the lowest points vote.
SQUARE = 0.3
# Share of the squares that a floor has at least.
MIN_SUPPORT = 0.05
# A point farther below a plane than this speaks against it being the floor.
BELOW = 0.2


def find_floor(
    points: np.ndarray, up: np.ndarray, seen_from: np.ndarray | None, max_tilt: float, distance: float
) -> tuple[np.ndarray, float, float] | None:
    """The lowest large plane that is nearly level: unit normal n (3,) upwards, height h with n·p = h, and its support.

    None without one. The support is the share of the squares of which the lowest point lies on the plane, less twice
    the share of those below it.

    Planes through triples of points (seeded, so that two runs agree) within `max_tilt` of `up` are scored by the points
    on them, less twice the points under them; the best are fitted to their points by least squares and scored again.

    Args:
        points: (N, 3) [m], thinned, so that what is near does not weigh more.
        up: unit vector (3,), about upwards.
        seen_from: where the sensor was [m]; the floor is under it.
        max_tilt: [rad].
        distance: a point this near to the plane lies on it [m].
    """
    if len(points) < 50:
        return None
    rng = np.random.default_rng(0)
    height = points @ up
    lowest, over = _over_lowest(points, height, up)
    ground = points[over < distance]
    below_eye = lowest if seen_from is None else lowest[height[lowest] < seen_from @ up]
    if len(below_eye) < 30:
        return None
    low = points[below_eye]
    triples = low[rng.integers(0, len(low), (TRIPLES, 3))]
    sample = np.ascontiguousarray(points[rng.permutation(lowest)[:600]])
    planes, votes = _vote(triples, sample, up, np.cos(max_tilt), distance)
    best, best_score = None, 0.0
    for k in np.argsort(-votes, kind="stable")[:FITTED]:
        fitted = _fit(ground, planes[k, :3], planes[k, 3], up, distance) if votes[k] > 0 else None
        if fitted is None or fitted[0] @ up < np.cos(max_tilt):
            continue
        miss = points[lowest] @ fitted[0] - fitted[1]
        score = float((np.abs(miss) < distance / 2).sum() - 2 * (miss < -BELOW).sum())
        if score > max(best_score, MIN_SUPPORT * len(lowest)):
            best, best_score = (*fitted, score / len(lowest)), score
    return best


def _over_lowest(points: np.ndarray, height: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index of the lowest point of each square of `SQUARE`, and how far every point is over that of its own [m].

    Only these vote: in a small room a leaning plane cuts all rings on the walls, and so has more points than the floor.
    """
    side = np.cross(up, [0.0, 1.0, 0.0] if abs(up[1]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    i = np.floor(points @ side / SQUARE).astype(np.int64)
    j = np.floor(points @ np.cross(up, side) / SQUARE).astype(np.int64)
    _, square = np.unique((i << 32) + j, return_inverse=True)
    order = np.lexsort((height, square))
    first = np.flatnonzero(np.concatenate([[True], np.diff(square[order]) > 0]))
    lowest = order[first]
    return lowest, height - height[lowest][square]


def _fit(
    points: np.ndarray, n: np.ndarray, h: float, up: np.ndarray, distance: float
) -> tuple[np.ndarray, float] | None:
    """The plane n·p = h, fitted to the points near it; None if they are few or on one line."""
    for gate in (2 * distance, distance, distance / 2, distance / 2):
        on = points[np.abs(points @ n - h) < gate]
        if len(on) < 40:
            return None
        centre = on.mean(axis=0)
        spread, axes = np.linalg.eigh(np.cov((on - centre).T))
        n = axes[:, 0] * np.sign(axes[:, 0] @ up)
        h = float(n @ centre)
    return (n, h) if np.sqrt(spread[1]) > 0.4 else None


@njit(cache=True)
def _vote(
    triples: np.ndarray, points: np.ndarray, up: np.ndarray, min_cosine: float, distance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Planes n, h (P, 4) through triples of points (P, 3, 3), and their votes (P,); 0 for what is no floor."""
    planes, votes = np.zeros((len(triples), 4)), np.zeros(len(triples))
    for k in range(len(triples)):
        a, b, c = triples[k, 0], triples[k, 1], triples[k, 2]
        u0, u1, u2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        v0, v1, v2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        n0, n1, n2 = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
        length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        if length < 0.5:  # [m²] small triangles say little about the slope
            continue
        cosine = (n0 * up[0] + n1 * up[1] + n2 * up[2]) / length
        if abs(cosine) < min_cosine:
            continue
        scale = (1.0 if cosine > 0 else -1.0) / length
        n0, n1, n2 = scale * n0, scale * n1, scale * n2
        h = n0 * a[0] + n1 * a[1] + n2 * a[2]
        planes[k] = n0, n1, n2, h
        for i in range(len(points)):
            over = n0 * points[i, 0] + n1 * points[i, 1] + n2 * points[i, 2] - h
            if over < -BELOW:
                votes[k] -= 2.0
            elif abs(over) < distance:
                votes[k] += 1.0
    return planes, votes
