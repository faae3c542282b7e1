"""Planes through neighbouring points, in numba: neighbours in a range image, and neighbours in a grid."""

import math

import numpy as np
from numba import njit

from .grid_kernels import cell_key, find_slot

# A plane's neighbours are this much thinner than wide at least (variances), and as wide as this part of their length.
_FLAT, _NARROW = 0.06, 0.02
_PLANE, _LINE, _NOTHING = range(3)
# A plane needs this many neighbours, and its normal a smaller variance than this [rad²]: 2°.
_MIN_NEIGHBOURS, _MOST_TILT = 8, 0.035**2
# This part of the neighbours, and so many, must be on other rings than the one that most of them are on: where a ring
# turns a corner its points make a plane, but that of the beam's cone.
_OTHER_RINGS, _OTHERS = 0.15, 4
# Among neighbours within twice the radius a plane is not thicker than this part: there, walls join the floor's.
_WIDE = 0.25
# Neighbours are gathered in so many columns to either side, and rows.
_COLUMNS, _ROWS = 5, 3


@njit(cache=True, fastmath=True)
def smallest_axis(c: np.ndarray) -> tuple[float, float, float, float, float, float]:
    """Eigenvalues, ascending, of the symmetric matrix [[c0, c1, c2], [c1, c3, c4], [c2, c4, c5]] and the unit vector of
    the smallest: the roots of the characteristic polynomial by the cosine of a third of an angle."""
    mean = (c[0] + c[3] + c[5]) / 3
    a, d, f = c[0] - mean, c[3] - mean, c[5] - mean
    off = c[1] * c[1] + c[2] * c[2] + c[4] * c[4]
    size = math.sqrt((a * a + d * d + f * f + 2 * off) / 6) + 1e-30
    det = a * (d * f - c[4] * c[4]) - c[1] * (c[1] * f - c[4] * c[2]) + c[2] * (c[1] * c[4] - d * c[2])
    angle = math.acos(min(1.0, max(-1.0, det / (2 * size**3)))) / 3
    large = mean + 2 * size * math.cos(angle)
    small = mean + 2 * size * math.cos(angle + 2 * math.pi / 3)
    middle = 3 * mean - small - large
    # The axis is across any two rows of C - small I: the longest of their products is the most exact.
    a, d, f = c[0] - small, c[3] - small, c[5] - small
    x0, y0, z0 = c[1] * c[4] - c[2] * d, c[2] * c[1] - a * c[4], a * d - c[1] * c[1]
    x1, y1, z1 = c[1] * f - c[2] * c[4], c[2] * c[2] - a * f, a * c[4] - c[1] * c[2]
    x2, y2, z2 = d * f - c[4] * c[4], c[4] * c[2] - c[1] * f, c[1] * c[4] - d * c[2]
    n0, n1, n2 = x0 * x0 + y0 * y0 + z0 * z0, x1 * x1 + y1 * y1 + z1 * z1, x2 * x2 + y2 * y2 + z2 * z2
    if n1 > n0 and n1 >= n2:
        x0, y0, z0, n0 = x1, y1, z1, n1
    elif n2 > n0:
        x0, y0, z0, n0 = x2, y2, z2, n2
    scale = 1 / math.sqrt(n0 + 1e-60)
    return small, middle, large, x0 * scale, y0 * scale, z0 * scale


@njit(cache=True, fastmath=True)
def _fit(sums: np.ndarray, neighbours: int, point: np.ndarray, thickness: float, surfel: np.ndarray) -> int:
    """Lays `point` on the plane of its neighbours, of which `sums` has weight, Σ d and Σ d dᵀ with d from the point.

    Writes position, unit normal, tilt (variance of the normal's direction [rad²]) and number of neighbours to `surfel`
    (8,) where the neighbours make a _PLANE no thicker than `thickness`; else says that they make a _LINE, or _NOTHING.
    """
    if neighbours < _MIN_NEIGHBOURS:
        return _NOTHING
    for i in range(1, 10):
        sums[i] /= sums[0]
    x, y, z = sums[1], sums[2], sums[3]
    sums[4] -= x * x
    sums[5] -= x * y
    sums[6] -= x * z
    sums[7] -= y * y
    sums[8] -= y * z
    sums[9] -= z * z
    small, middle, large, nx, ny, nz = smallest_axis(sums[4:10])
    if middle < _NARROW * large:
        return _LINE
    tilt = max(small, 0.0) / (neighbours * middle)
    if small > _FLAT * middle or small > thickness * thickness or tilt > _MOST_TILT:
        return _NOTHING
    height = x * nx + y * ny + z * nz
    surfel[0], surfel[1], surfel[2] = point[0] + height * nx, point[1] + height * ny, point[2] + height * nz
    surfel[3], surfel[4], surfel[5] = nx, ny, nz
    surfel[6], surfel[7] = tilt, neighbours
    return _PLANE


@njit(cache=True, fastmath=True)
def _add(sums: np.ndarray, weight: float, x: float, y: float, z: float) -> None:
    sums[0] += weight
    sums[1] += weight * x
    sums[2] += weight * y
    sums[3] += weight * z
    sums[4] += weight * x * x
    sums[5] += weight * x * y
    sums[6] += weight * x * z
    sums[7] += weight * y * y
    sums[8] += weight * y * z
    sums[9] += weight * z * z


@njit(cache=True, fastmath=True)
def image_means(
    points: np.ndarray,
    row: np.ndarray,
    column: np.ndarray,
    rows: int,
    columns: int,
    height: int,
    width: int,
    gate: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means of blocks of `height` × `width` pixels of a range image, of what is within `gate` of their middle pixel.

    Args:
        row, column: of every point (N, 3) in the image. rows, columns: number of blocks.

    Returns:
        means (rows, columns, 3), the number of points in each (rows, columns), 0 where the block is empty, and the
        index of the middle point.
    """
    index = np.full((rows * height, columns * width), -1, np.int32)
    for p in range(len(points)):
        index[row[p], column[p]] = p
    means = np.zeros((rows, columns, 3))
    counts = np.zeros((rows, columns))
    middle = np.full((rows, columns), -1, np.int32)
    for r in range(rows):
        for c in range(columns):
            nearest, best = -1, 1e9
            for i in range(height):
                for j in range(width):
                    p = index[r * height + i, c * width + j]
                    offset = abs(i - 0.5 * (height - 1)) + abs(j - 0.5 * (width - 1))
                    if p >= 0 and offset < best:
                        best, nearest = offset, p
            if nearest < 0:
                continue
            middle[r, c] = nearest
            x0, y0, z0 = points[nearest, 0], points[nearest, 1], points[nearest, 2]
            n, sx, sy, sz = 0, 0.0, 0.0, 0.0
            for i in range(height):
                for j in range(width):
                    p = index[r * height + i, c * width + j]
                    if p >= 0:
                        x, y, z = points[p, 0] - x0, points[p, 1] - y0, points[p, 2] - z0
                        if x * x + y * y + z * z < gate * gate:
                            n += 1
                            sx += x
                            sy += y
                            sz += z
            counts[r, c] = n
            means[r, c, 0], means[r, c, 1], means[r, c, 2] = x0 + sx / n, y0 + sy / n, z0 + sz / n
    return means, counts, middle


@njit(cache=True, fastmath=True)
def _gather_pixels(
    means: np.ndarray, counts: np.ndarray, r: int, c: int, step: float, reach: float, sums: np.ndarray
) -> tuple[int, int]:
    """Sums up the pixels around one that are within `reach`; columns are `step` [m] apart there.

    Returns their number, and that of those which are not on the ring that most of them are on.
    """
    rows, columns = counts.shape
    x0, y0, z0 = means[r, c, 0], means[r, c, 1], means[r, c, 2]
    stride = max(1, min(int(reach / (step + 1e-6)), columns // 8) // _COLUMNS)
    sums[:] = 0.0
    n, most = 0, 0
    for i in range(max(0, r - _ROWS), min(rows, r + _ROWS + 1)):
        before = n
        for k in range(-_COLUMNS, _COLUMNS + 1):
            j = (c + k * stride) % columns
            if counts[i, j] == 0:
                continue
            x, y, z = means[i, j, 0] - x0, means[i, j, 1] - y0, means[i, j, 2] - z0
            if x * x + y * y + z * z < reach * reach:
                _add(sums, counts[i, j], x, y, z)
                n += 1
        most = max(most, n - before)
    return n, n - most


@njit(cache=True, fastmath=True)
def image_surfels(
    means: np.ndarray,
    counts: np.ndarray,
    middle: np.ndarray,
    radius: float,
    widening: float,
    spacing: float,
    thickness: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Planes through the pixels of a range image (rows, columns, 3) and what is around them.

    What is around is within `radius`, or the part `widening` of the distance from the origin where that is more; within
    twice of it where that is a line: on a floor rings are far apart.

    Pixels nearer to each other along a row than `spacing` are thinned. The neighbours are a window of several rows, or
    else all lie on a line, as wide as `radius` at the pixel's own distance; the image is closed at its sides.

    Returns:
        surfels (N, 8): position, normal (towards the origin), tilt, neighbours, see `_fit`; and the index of the
        middle point of each.
    """
    rows, columns = counts.shape
    surfels = np.empty((rows * columns, 8))
    which = np.empty(rows * columns, np.int32)
    sums = np.empty(10)
    found = 0
    for r in range(rows):
        for c in range(columns):
            if counts[r, c] == 0:
                continue
            x0, y0, z0 = means[r, c, 0], means[r, c, 1], means[r, c, 2]
            step = 1e9  # [m] from one column to the next
            for side in (-1, 1):
                other = (c + side) % columns
                if counts[r, other] > 0:
                    x, y, z = means[r, other, 0] - x0, means[r, other, 1] - y0, means[r, other, 2] - z0
                    step = min(step, math.sqrt(x * x + y * y + z * z))
            thin = 1
            while thin * step < 0.75 * spacing and thin < 64:
                thin *= 2
            reach = max(radius, widening * math.sqrt(x0 * x0 + y0 * y0 + z0 * z0))
            if c % thin != 0 or step > reach:
                continue
            fit, limit = _LINE, thickness
            for _ in range(2):
                n, others = _gather_pixels(means, counts, r, c, step, reach, sums)
                if others >= max(_OTHER_RINGS * n, _OTHERS):
                    fit = _fit(sums, n, means[r, c], limit, surfels[found])
                    if fit != _LINE:
                        break
                reach, limit = 2 * reach, _WIDE * thickness
            if fit == _PLANE:
                s = surfels[found]
                if s[0] * s[3] + s[1] * s[4] + s[2] * s[5] > 0:
                    s[3], s[4], s[5] = -s[3], -s[4], -s[5]
                which[found] = middle[r, c]
                found += 1
    return surfels[:found].copy(), which[:found].copy()


@njit(cache=True, fastmath=True)
def cloud_surfels(
    points: np.ndarray,
    weights: np.ndarray,
    centres: np.ndarray,
    keys: np.ndarray,
    ends: np.ndarray,
    order: np.ndarray,
    radius: float,
    thickness: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Planes through those `points` (N, 3), with `weights` (N,), that `centres` (M,) names, and all within `radius`, or
    within twice of it where that is a line.

    Args:
        keys, ends, order: the points in cells of edge length `radius`, see `sort_into_cells`.

    Returns:
        surfels (L, 8): position, normal (its sign is arbitrary), tilt, neighbours, see `_fit`; the points' indices; and
        the indices of those among many neighbours that make no plane.
    """
    surfels = np.empty((len(centres), 8))
    which = np.empty(len(centres), np.int32)
    clutter = np.empty(len(centres), np.int32)
    sums = np.empty(10)
    found, unordered = 0, 0
    for centre in centres:
        x0, y0, z0 = points[centre, 0], points[centre, 1], points[centre, 2]
        fit = _LINE
        for span in (1, 2):
            n = 0
            sums[:] = 0.0
            i0, j0, k0 = int(np.floor(x0 / radius)), int(np.floor(y0 / radius)), int(np.floor(z0 / radius))
            for i in range(i0 - span, i0 + span + 1):
                for j in range(j0 - span, j0 + span + 1):
                    for k in range(k0 - span, k0 + span + 1):
                        slot = find_slot(keys, cell_key(i, j, k))
                        for o in range(ends[slot, 0], ends[slot, 1]):
                            p = order[o]
                            x, y, z = points[p, 0] - x0, points[p, 1] - y0, points[p, 2] - z0
                            if x * x + y * y + z * z < (span * radius) ** 2:
                                _add(sums, weights[p], x, y, z)
                                n += 1
            limit = thickness if span == 1 else _WIDE * thickness
            fit = _fit(sums, n, points[centre], limit, surfels[found])
            if fit != _LINE:
                break
        if fit == _PLANE:
            which[found] = centre
            found += 1
        elif n >= _MIN_NEIGHBOURS:
            clutter[unordered] = centre
            unordered += 1
    return surfels[:found].copy(), which[:found].copy(), clutter[:unordered].copy()
