"""Loops of path smoothing, in cells: cell (i, j) has its centre at (i, j)."""

import numpy as np
from numba import njit


@njit(cache=True)
def sample(field: np.ndarray, x: float, y: float) -> float:
    """Bilinear value of a field (nx, ny); beyond its centres that of the edge."""
    nx, ny = field.shape
    x, y = min(max(x, 0.0), nx - 1.0), min(max(y, 0.0), ny - 1.0)
    i, j = min(int(x), max(nx - 2, 0)), min(int(y), max(ny - 2, 0))
    k, l = min(i + 1, nx - 1), min(j + 1, ny - 1)  # noqa: E741
    p, q = x - i, y - j
    low = field[i, j] * (1 - p) + field[k, j] * p
    return low * (1 - q) + (field[i, l] * (1 - p) + field[k, l] * p) * q


@njit(cache=True)
def segment(ax: float, ay: float, bx: float, by: float, weight: np.ndarray, room: np.ndarray) -> tuple[float, float]:
    """Cost of a straight way [cells], and the least value of `room` on it."""
    length = np.hypot(bx - ax, by - ay)
    steps = max(int(np.ceil(4 * length)), 1)
    cost, least = 0.0, np.inf
    for s in range(steps + 1):
        t = s / steps
        x, y = ax + t * (bx - ax), ay + t * (by - ay)
        least = min(least, sample(room, x, y))
        share = 0.5 if s == 0 or s == steps else 1.0
        cost += share * sample(weight, x, y)
    return cost * length / steps, least


@njit(cache=True)
def weigh(ax: float, ay: float, bx: float, by: float, table: np.ndarray) -> int:
    """Weight of the rays that a straight way crosses, see `Islands`."""
    if ax == bx:
        return 0
    low, high = min(ax, bx), max(ax, bx)
    total = 0
    # Columns whose right edge lies in [low, high): the way is left of it or on it at one end and right of it at the
    # other.
    for i in range(int(np.ceil(low - 0.5)), int(np.ceil(high - 0.5))):
        y = ay + (i + 0.5 - ax) / (bx - ax) * (by - ay)
        j = min(max(int(np.ceil(y)), 0), table.shape[1] - 1)
        total += int(table[min(max(i, 0), table.shape[0] - 1), j])
    return total if bx > ax else -total


@njit(cache=True)
def shortcut(
    points: np.ndarray,
    cost: np.ndarray,
    straight: np.ndarray,
    weight: np.ndarray,
    room: np.ndarray,
    least_room: float,
    table: np.ndarray,
    tolerance: float,
) -> np.ndarray:
    """Indices of the points that remain when straight ways replace what costs as much and passes the islands alike.

    Args:
        points: (K, 2) [cells]. cost: (K,) from the first point on.
        straight: (K,) bool: a cut may leave out the point; false keeps it, as on steep ground.
    """
    count = points.shape[0]
    crossed = np.zeros(count, np.int64)
    for k in range(1, count):
        over = weigh(points[k - 1, 0], points[k - 1, 1], points[k, 0], points[k, 1], table)
        crossed[k] = crossed[k - 1] + over
    kept = [0]
    at = 0
    while at < count - 1:
        best = at + 1
        for to in range(at + 2, count):
            if not straight[to - 1]:
                break
            ax, ay, bx, by = points[at, 0], points[at, 1], points[to, 0], points[to, 1]
            value, least = segment(ax, ay, bx, by, weight, room)
            alike = weigh(ax, ay, bx, by, table) == crossed[to] - crossed[at]
            if least >= least_room and alike and value <= (cost[to] - cost[at]) * (1 + tolerance):
                best = to
        kept.append(best)
        at = best
    return np.array(kept)


@njit(cache=True)
def relax(points: np.ndarray, fixed: np.ndarray, room: np.ndarray, want: float, tension: float, steps: int) -> None:
    """Smooths a path (K, 2) [cells] in place: less bending, and away from what is nearer than `want`.

    A point goes only where it and the middles of its two sides keep `want`, or at least what they had. `tension`, up to
    0.2, shortens the path.
    """
    count = points.shape[0]
    for _ in range(steps):
        for k in range(1, count - 1):
            if fixed[k]:
                continue
            x, y = points[k, 0], points[k, 1]
            mx = 0.5 * (points[k - 1, 0] + points[k + 1, 0]) - x
            my = 0.5 * (points[k - 1, 1] + points[k + 1, 1]) - y
            if k >= 2 and k < count - 2:
                bx = (4 * (points[k - 1, 0] + points[k + 1, 0]) - points[k - 2, 0] - points[k + 2, 0]) / 6 - x
                by = (4 * (points[k - 1, 1] + points[k + 1, 1]) - points[k - 2, 1] - points[k + 2, 1]) / 6 - y
                dx, dy = 0.7 * bx + tension * mx, 0.7 * by + tension * my
            else:
                dx, dy = 0.5 * mx, 0.5 * my
            here = sample(room, x, y)
            if here < want:
                gx = sample(room, x + 0.5, y) - sample(room, x - 0.5, y)
                gy = sample(room, x, y + 0.5) - sample(room, x, y - 0.5)
                norm = np.hypot(gx, gy)
                if norm > 1e-9:
                    push = 0.1 * (want - here)
                    dx += push * gx / norm
                    dy += push * gy / norm
            u, v = x + dx, y + dy
            allowed = sample(room, u, v) >= min(want, here)
            for o in (-1, 1):
                px, py = points[k + o, 0], points[k + o, 1]
                before = sample(room, 0.5 * (x + px), 0.5 * (y + py))
                allowed = allowed and sample(room, 0.5 * (u + px), 0.5 * (v + py)) >= min(want, before)
            if allowed:
                points[k, 0], points[k, 1] = u, v
