"""Compiled plane fits and features of rectangles of ground."""

import math

import numpy as np
from numba import njit

# Planes through three cells that are tried as a start, and steps of the robust fit from there.
_TRIALS, _STEPS = 24, 8
# [m] Least spread that is believed: range noise alone makes that much.
_LEAST_SPREAD = 0.01
# Tukey's constant, and the median absolute deviation to a standard deviation.
_TUKEY, _MAD_SCALE = 4.685, 1.4826


@njit(cache=True)
def solve_plane(moments: np.ndarray) -> tuple[float, float, float, bool]:
    """a, b, c of z = a x + b y + c from the sums n, x, y, z, xx, xy, yy, xz, yz; False where they give no plane."""
    n = moments[0]
    if n <= 0.0:
        return 0.0, 0.0, 0.0, False
    mx, my, mz = moments[1] / n, moments[2] / n, moments[3] / n
    xx, xy, yy = moments[4] / n - mx * mx, moments[5] / n - mx * my, moments[6] / n - my * my
    xz, yz = moments[7] / n - mx * mz, moments[8] / n - my * mz
    det = xx * yy - xy * xy
    if det <= 1e-4 * (xx + yy) * (xx + yy) or det <= 1e-12:
        return 0.0, 0.0, 0.0, False
    a, b = (xz * yy - yz * xy) / det, (yz * xx - xz * xy) / det
    return a, b, mz - a * mx - b * my, True


@njit(cache=True)
def _add(moments: np.ndarray, w: float, x: float, y: float, z: float) -> None:
    moments[0] += w
    moments[1] += w * x
    moments[2] += w * y
    moments[3] += w * z
    moments[4] += w * x * x
    moments[5] += w * x * y
    moments[6] += w * y * y
    moments[7] += w * x * z
    moments[8] += w * y * z


@njit(cache=True)
def _median(values: np.ndarray, size: int) -> float:
    """The middle one of the first `size` values, which are left in another order."""
    low, high, middle = 0, size - 1, size // 2
    while low < high:
        pivot, i, j = values[(low + high) // 2], low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            break
    return values[middle]


@njit(cache=True)
def robust_plane(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, size: int, scratch: np.ndarray
) -> tuple[float, float, float, bool]:
    """The plane z = a x + b y + c that most of the points are near to.

    Starts at the best of some planes through three points and of the one of least squares, by the median of the
    distances (Rousseeuw's least median of squares, so up to half of the points may be wrong), and goes on by
    iteratively re-weighted least squares with Tukey's weight.
    """
    moments = np.zeros(9)
    for n in range(size):
        _add(moments, 1.0, x[n], y[n], z[n])
    a, b, c, found = solve_plane(moments)
    if not found:
        return a, b, c, False
    best = _typical_distance(x, y, z, size, a, b, c, scratch)
    state = np.uint64(12345)
    for _ in range(_TRIALS):
        moments[:] = 0.0
        for _ in range(3):
            state = state * np.uint64(6364136223846793005) + np.uint64(1442695040888963407)
            n = int((state >> np.uint64(33)) % np.uint64(size))
            _add(moments, 1.0, x[n], y[n], z[n])
        ta, tb, tc, fits = solve_plane(moments)
        if fits:
            typical = _typical_distance(x, y, z, size, ta, tb, tc, scratch)
            if typical < best:
                best, a, b, c = typical, ta, tb, tc
    limit = _TUKEY * max(_MAD_SCALE * best, _LEAST_SPREAD)
    for _ in range(_STEPS):
        moments[:] = 0.0
        for n in range(size):
            share = (z[n] - a * x[n] - b * y[n] - c) / limit
            if -1.0 < share < 1.0:
                w = (1.0 - share * share) ** 2
                _add(moments, w, x[n], y[n], z[n])
        ta, tb, tc, fits = solve_plane(moments)
        if not fits:
            break
        moved = abs(ta - a) + abs(tb - b) + abs(tc - c)
        a, b, c = ta, tb, tc
        if moved < 1e-5:
            break
    return a, b, c, True


@njit(cache=True)
def _typical_distance(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, size: int, a: float, b: float, c: float, scratch: np.ndarray
) -> float:
    for n in range(size):
        scratch[n] = abs(z[n] - a * x[n] - b * y[n] - c)
    return _median(scratch, size)


@njit(cache=True)
def slopes(a: float, b: float, theta: float) -> tuple[float, float]:
    """Pitch slope and roll slope of a plane along a direction, Eq. 2 and 3 [rad]."""
    norm = math.sqrt(a * a + b * b + 1.0)
    cosine, sine = math.cos(theta), math.sin(theta)
    pitch = abs(math.acos((-a * cosine - b * sine) / norm) - 0.5 * math.pi)
    roll = abs(math.acos((a * sine - b * cosine) / norm) - 0.5 * math.pi)
    return pitch, roll


@njit(cache=True)
def point_planes(
    points: np.ndarray, directions: np.ndarray, start: float, depth: float, width: float, ceiling: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The paper's features over all points: count, mean height, plane and roughness of every rectangle, Eq. 1, 4-6."""
    size = directions.shape[0]
    moments, planes = np.zeros((size, 9)), np.full((size, 3), np.nan)
    distance, square = np.zeros(size), np.zeros(size)
    cosine, sine = np.cos(directions), np.sin(directions)
    reach = (start + depth) ** 2 + 0.25 * width * width
    inside = np.empty(points.shape[0], np.int32)
    held = 0
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        if x * x + y * y <= reach and -ceiling < z < ceiling:
            inside[held] = n
            held += 1
    for k in range(size):
        for m in range(held):
            x, y, z = points[inside[m], 0], points[inside[m], 1], points[inside[m], 2]
            along, across = x * cosine[k] + y * sine[k] - start, y * cosine[k] - x * sine[k]
            if 0.0 <= along <= depth and -0.5 * width <= across <= 0.5 * width:
                _add(moments[k], 1.0, x, y, z)
        a, b, c, found = solve_plane(moments[k])
        if not found:
            continue
        planes[k, 0], planes[k, 1], planes[k, 2] = a, b, c
        norm = math.sqrt(a * a + b * b + 1.0)
        for m in range(held):
            x, y, z = points[inside[m], 0], points[inside[m], 1], points[inside[m], 2]
            along, across = x * cosine[k] + y * sine[k] - start, y * cosine[k] - x * sine[k]
            if 0.0 <= along <= depth and -0.5 * width <= across <= 0.5 * width:
                d = abs(a * x + b * y + c - z) / norm
                distance[k] += d
                square[k] += d * d
    count = moments[:, 0]
    mean = np.where(count > 0, moments[:, 3] / np.maximum(count, 1.0), np.nan)
    roughness = np.where(
        np.isfinite(planes[:, 0]),
        square / np.maximum(count, 1.0) - (distance / np.maximum(count, 1.0)) ** 2,
        np.nan,
    )
    return count, mean, planes, np.maximum(roughness, 0.0)


@njit(cache=True)
def cell_planes(
    low: np.ndarray,
    high: np.ndarray,
    steps: np.ndarray,
    x0: float,
    y0: float,
    cell: float,
    directions: np.ndarray,
    start: float,
    depth: float,
    width: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Cells seen, mean height, plane, roughness, coverage and step of every rectangle, from the surface's cells."""
    nx, ny = low.shape
    size = directions.shape[0]
    count, mean, roughness = np.zeros(size), np.full(size, np.nan), np.full(size, np.nan)
    planes, coverage, step = np.full((size, 3), np.nan), np.zeros(size), np.full(size, np.nan)
    x, y, z, middle, scratch = np.empty((5, nx * ny))
    for k in range(size):
        cosine, sine = math.cos(directions[k]), math.sin(directions[k])
        cells, covered, held, highest = 0, 0, 0, 0.0
        for i in range(nx):
            for j in range(ny):
                u, v = x0 + (i + 0.5) * cell, y0 + (j + 0.5) * cell
                along, across = u * cosine + v * sine - start, v * cosine - u * sine
                if not (0.0 <= along <= depth and -0.5 * width <= across <= 0.5 * width):
                    continue
                cells += 1
                if np.isfinite(low[i, j]):
                    x[held], y[held], z[held] = u, v, low[i, j]
                    middle[held] = 0.5 * (low[i, j] + high[i, j])
                    highest = max(highest, steps[i, j])
                    held += 1
                    covered += 1
                elif _enclosed(low, i, j):
                    covered += 1
        count[k] = held
        coverage[k] = covered / cells if cells else 0.0
        if held < 3:
            continue
        mean[k], step[k] = middle[:held].mean(), highest
        a, b, c, found = robust_plane(x, y, z, held, scratch)
        if not found:
            continue
        planes[k, 0], planes[k, 1], planes[k, 2] = a, b, c
        norm, distance, square = math.sqrt(a * a + b * b + 1.0), 0.0, 0.0
        for n in range(held):
            d = abs(a * x[n] + b * y[n] + c - middle[n]) / norm
            distance += d
            square += d * d
        roughness[k] = max(square / held - (distance / held) ** 2, 0.0)
    return count, mean, planes, roughness, coverage, step


@njit(cache=True)
def _enclosed(low: np.ndarray, i: int, j: int) -> bool:
    """Whether a cell that was not seen lies between two that were."""
    nx, ny = low.shape
    if 0 < i < nx - 1 and np.isfinite(low[i - 1, j]) and np.isfinite(low[i + 1, j]):
        return True
    return 0 < j < ny - 1 and np.isfinite(low[i, j - 1]) and np.isfinite(low[i, j + 1])
