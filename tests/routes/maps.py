"""Seeded maps for tests and benchmarks of routes: mazes, halls with debris, and halls with water in the way."""

import numpy as np
from naraha.systems.routes.route_grid import FENCE, FREE, OCCUPIED, WATER, RouteGrid
from scipy.ndimage import label

Place = tuple[float, float]


def water_map(seed: int, sides: str = "both", size: tuple[int, int] = (40, 30)) -> tuple[RouteGrid, np.ndarray, Place]:
    """A fenced hall, start at one end, goal at the other, water between them, debris here and there.

    Args:
        sides: where the water can be passed, seen from start to goal: "both", "left", "right" or "none".

    Returns:
        The grid (cell 0.2 m, origin not at zero), start (3,) x, y, heading towards +x [m, m, rad], goal x, y [m].
        The way past the water on every side that `sides` names is at least three cells wide.
    """
    rng = np.random.default_rng(seed)
    nx, ny = size
    kind = fenced(nx, ny)
    middle = np.array([nx / 2 + rng.integers(-3, 4), ny / 2 + rng.integers(-2, 3)])
    radius = np.array([rng.uniform(3, 6), rng.uniform(4, ny / 2 - 7)])
    x, y = np.ogrid[:nx, :ny]
    pool = ((x - middle[0]) / radius[0]) ** 2 + ((y - middle[1]) / radius[1]) ** 2 < 1
    column = round(middle[0])
    if sides in ("left", "none"):  # no way on the right (smaller y)
        pool[column - 1 : column + 2, : round(middle[1])] = True
    if sides in ("right", "none"):
        pool[column - 1 : column + 2, round(middle[1]) :] = True
    start, goal = np.array([3, ny // 2 + rng.integers(-4, 5)]), np.array([nx - 4, ny // 2 + rng.integers(-4, 5)])
    for _ in range(int(rng.integers(10, 25))):  # debris beside the pool, not between the pool and the walls
        w, h = rng.integers(1, 4, 2)
        i, j = rng.integers(5, nx - 8), rng.integers(2, ny - 5)
        near_pool = abs(i + w / 2 - middle[0]) < radius[0] + w + 3
        if not near_pool and min(np.hypot(i - p, j - q) for p, q in (start, goal)) > 5:
            kind[i : i + w, j : j + h] = OCCUPIED
    kind[pool & (kind == FREE)] = WATER
    return _with_ends(kind, start, goal)


def hall_map(seed: int, size: tuple[int, int] = (40, 30), filled: float = 0.15) -> tuple[RouteGrid, np.ndarray, Place]:
    """A fenced hall with boxes and pools on about `filled` of its floor; the goal can be reached. Returns as above."""
    rng = np.random.default_rng(seed)
    nx, ny = size
    while True:
        kind = fenced(nx, ny)
        while (kind[1:-1, 1:-1] != FREE).mean() < filled:
            i, j = rng.integers(1, nx - 2), rng.integers(1, ny - 2)
            if rng.random() < 0.7:
                w, h = rng.integers(1, 6, 2)
                kind[i : min(i + w, nx - 1), j : min(j + h, ny - 1)] = OCCUPIED
            else:
                x, y = np.ogrid[:nx, :ny]
                kind[((x - i) ** 2 + (y - j) ** 2 < rng.uniform(1.5, 4) ** 2) & (kind == FREE)] = WATER
        start = np.array([rng.integers(2, 5), rng.integers(2, ny - 2)])
        goal = np.array([rng.integers(nx - 5, nx - 2), rng.integers(2, ny - 2)])
        if connected(kind, start, goal):
            return _with_ends(kind, start, goal)


def maze_map(seed: int, cells: tuple[int, int] = (6, 5), wide: int = 3) -> tuple[RouteGrid, np.ndarray, Place]:
    """A maze with corridors `wide` cells across and walls of one, all places connected, a few loops. As above."""
    rng = np.random.default_rng(seed)
    m, n = cells
    pitch = wide + 1
    kind = np.full((m * pitch + 1, n * pitch + 1), OCCUPIED, np.uint8)
    for a, b in np.ndindex(m, n):
        kind[a * pitch + 1 : (a + 1) * pitch, b * pitch + 1 : (b + 1) * pitch] = FREE
    doors = [((a, b), (a + 1, b)) for a in range(m - 1) for b in range(n)]
    doors += [((a, b), (a, b + 1)) for a in range(m) for b in range(n - 1)]
    group = {place: place for place in np.ndindex(m, n)}

    def root(place: tuple[int, ...]) -> tuple[int, ...]:
        while group[place] != place:
            place = group[place]
        return place

    for k in rng.permutation(len(doors)):
        (a, b), other = doors[k]
        if root((a, b)) != root(other) or rng.random() < 0.1:
            group[root((a, b))] = root(other)
            if other[0] > a:
                kind[(a + 1) * pitch, b * pitch + 1 : (b + 1) * pitch] = FREE
            else:
                kind[a * pitch + 1 : (a + 1) * pitch, (b + 1) * pitch] = FREE
    kind[[0, -1]] = kind[:, [0, -1]] = FENCE
    return _with_ends(kind, np.array([2, 2]), np.array(kind.shape) - 3)


def fenced(nx: int, ny: int) -> np.ndarray:
    """(nx, ny) uint8: free floor with a fence around it."""
    kind = np.zeros((nx, ny), np.uint8)
    kind[[0, -1]] = kind[:, [0, -1]] = FENCE
    return kind


def connected(kind: np.ndarray, start: np.ndarray, goal: np.ndarray) -> bool:
    """Whether a way over edges of cells leads from `start` to `goal`."""
    parts, _ = label(kind == FREE)
    return bool(parts[tuple(start)] > 0 and parts[tuple(start)] == parts[tuple(goal)])


def _with_ends(kind: np.ndarray, start: np.ndarray, goal: np.ndarray) -> tuple[RouteGrid, np.ndarray, Place]:
    grid = RouteGrid.from_kind(kind, 0.2, (-1.0, -2.0))
    x, y = grid.centre_of(goal)
    return grid, np.append(grid.centre_of(start), 0.0), (float(x), float(y))
