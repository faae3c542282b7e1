"""The compiled loop of Growing Cell Structures."""

import numpy as np
from numba import njit


@njit(cache=True)
def grow_cells(
    signals: np.ndarray, most: int, between: int, rates: tuple[float, float], decay: float
) -> tuple[np.ndarray, np.ndarray]:
    """Grows cells over signals, with triangles as the simplices that they are linked in (Fritzke 1992).

    For every signal the nearest cell moves towards it by the share rates[0] and its neighbours by rates[1]; its counter
    goes up by one, and all fall by the share `decay`. After every `between` signals a cell is inserted in the middle
    between the cell of the largest counter and its farthest neighbour, linked to both and to the neighbours that they
    share; the counters around it are divided by the areas that the cells lose to it. Growing ends with `most` cells;
    the signals that are left move them at falling rates.

    Args:
        signals: (n, 2).

    Returns:
        Positions (m, 2) and links (m, m) bool.
    """
    place = np.zeros((most, 2))
    links = np.zeros((most, most), np.bool_)
    counter = np.zeros(most)
    n = 3
    place[:3] = signals[:3]
    for a in range(3):
        for b in range(3):
            links[a, b] = a != b
    growing = (most - 3) * between
    for s in range(3, len(signals)):
        x, y = signals[s, 0], signals[s, 1]
        best, nearest = 0, np.inf
        for c in range(n):
            d = (place[c, 0] - x) ** 2 + (place[c, 1] - y) ** 2
            if d < nearest:
                best, nearest = c, d
        ease = 1.0 if n < most else max(0.0, 1.0 - (s - growing) / max(1, len(signals) - growing))
        for c in range(n):
            if c == best or links[best, c]:
                rate = ease * (rates[0] if c == best else rates[1])
                place[c, 0] += rate * (x - place[c, 0])
                place[c, 1] += rate * (y - place[c, 1])
            counter[c] *= 1.0 - decay
        counter[best] += 1.0
        if n < most and s % between == 0:
            _insert(place, links, counter, n)
            n += 1
    return place[:n], links[:n, :n]


@njit(cache=True)
def _insert(place: np.ndarray, links: np.ndarray, counter: np.ndarray, n: int) -> None:
    busy = 0
    for c in range(1, n):
        if counter[c] > counter[busy]:
            busy = c
    far, farthest = busy, -1.0
    for c in range(n):
        if links[busy, c]:
            d = (place[c, 0] - place[busy, 0]) ** 2 + (place[c, 1] - place[busy, 1]) ** 2
            if d > farthest:
                far, farthest = c, d
    place[n] = 0.5 * (place[busy] + place[far])
    before = np.zeros(n)
    for c in range(n):
        if c in (busy, far) or (links[busy, c] and links[far, c]):
            before[c] = _area(place, links, c, n)
    links[busy, far], links[far, busy] = False, False
    for c in range(n):
        if before[c] > 0.0:
            links[c, n], links[n, c] = True, True
    gained = 0.0
    for c in range(n):
        if before[c] > 0.0:
            lost = counter[c] * min(max(1.0 - _area(place, links, c, n + 1) / before[c], 0.0), 1.0)
            counter[c] -= lost
            gained += lost
    counter[n] = gained


@njit(cache=True)
def _area(place: np.ndarray, links: np.ndarray, c: int, n: int) -> float:
    """Square of the mean length of a cell's links, in place of the area of its Voronoi region."""
    total, count = 0.0, 0
    for k in range(n):
        if links[c, k]:
            total += np.hypot(place[k, 0] - place[c, 0], place[k, 1] - place[c, 1])
            count += 1
    return (total / max(count, 1)) ** 2
