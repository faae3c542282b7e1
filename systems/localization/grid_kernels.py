"""Compiled parts of the occupancy grid and of its likelihood field.

What was hit is kept in five layers of a cell: number of hits, sum of their offsets from the cell's centre (x, y) [m]
and sum of the unit directions from them to the laser (x, y).
"""

import math

import numpy as np
from numba import njit

_FREE, _HIT = 1, 2
# Owners of cells that no scan hit first: of none, and of those that a plan says are occupied.
NOBODY, PLAN = -1, -2
# Half the windows that lines are fitted in [cells], the smaller for corners and clutter; part of the variance along a
# line that may be across it; least number of cells; largest deviation of the normal [rad], and deviation of a hit
# [cells].
_WINDOWS = np.array([3, 2, 1])
_STRAIGHT = np.array([0.05, 0.1, 0.2])
_LEAST_CELLS = np.array([4.0, 4.0, 3.0])
_NORMAL_DEVIATION = np.array([0.06, 0.12, 0.2])
_HIT_DEVIATION = 0.25
# Hits that make a post of a cell, cells around that make it clutter, and how far nothing else may be around a post.
_POST_HITS, _CLUTTER, _ALONE = 3.0, 6.0, 12
# Cosine of the incidence below which a surface is grazed: how it stands there, no one knows.
_GRAZED = 0.15
# Half the length of a surface element [cells]: neighbours on a diagonal wall, whose means may lie anywhere, overlap.
_HALF = 1.25


@njit(cache=True)
def add_scan(
    log_odds: np.ndarray,
    hits: np.ndarray,
    owner: np.ndarray,
    laser: np.ndarray,
    ends: np.ndarray,
    hit: float,
    miss: float,
    lowest: float,
    highest: float,
    sparse: float,
    keyframe: int,
) -> None:
    """Adds one scan in place: its end points are hit, what its beams cross is free; each cell once, a hit before free.

    Args:
        log_odds: (nx, ny) float32. hits: (nx, ny, 5) float32. owner: (nx, ny) int32, `NOBODY` where nothing was hit.
        laser: (2,) and ends: (n, 2), in cells from the corner of cell (0, 0); all inside the grid.
        hit, miss: what is added to the log-odds; lowest, highest: where it stops.
        sparse: ends farther from both their neighbours than this [cells] do not show a surface, only that it is there.
        keyframe: owner of the cells that are hit for the first time.
    """
    nx, ny = log_odds.shape
    i0 = max(int(min(laser[0], ends[:, 0].min())), 0)
    j0 = max(int(min(laser[1], ends[:, 1].min())), 0)
    i1 = min(int(max(laser[0], ends[:, 0].max())) + 1, nx)
    j1 = min(int(max(laser[1], ends[:, 1].max())) + 1, ny)
    seen = np.zeros((i1 - i0, j1 - j0), np.uint8)
    for k in range(len(ends)):
        i, j = int(ends[k, 0]), int(ends[k, 1])
        seen[i - i0, j - j0] = _HIT
        if owner[i, j] == NOBODY:
            owner[i, j] = keyframe
        if not _is_dense(ends, k, sparse):
            continue
        if log_odds[i, j] + hit <= 0.0:
            # What was free turns out not to be: what was hit there before is gone.
            hits[i, j, :] = 0.0
        dx, dy = laser[0] - ends[k, 0], laser[1] - ends[k, 1]
        far = max(math.hypot(dx, dy), 1e-9)
        hits[i, j, 0] += 1.0
        hits[i, j, 1] += ends[k, 0] - i - 0.5
        hits[i, j, 2] += ends[k, 1] - j - 0.5
        hits[i, j, 3] += dx / far
        hits[i, j, 4] += dy / far
    for k in range(len(ends)):
        _cross(seen, laser[0] - i0, laser[1] - j0, ends[k, 0] - i0, ends[k, 1] - j0)
    for i in range(i0, i1):
        for j in range(j0, j1):
            state = seen[i - i0, j - j0]
            if state == _HIT:
                log_odds[i, j] = min(log_odds[i, j] + hit, highest)
            elif state == _FREE:
                log_odds[i, j] = max(log_odds[i, j] + miss, lowest)
                if log_odds[i, j] <= 0.0 and owner[i, j] != NOBODY:
                    hits[i, j, :] = 0.0
                    owner[i, j] = NOBODY


@njit(cache=True)
def _is_dense(ends: np.ndarray, k: int, sparse: float) -> bool:
    for n in (k - 1, k + 1):
        if 0 <= n < len(ends) and math.hypot(ends[n, 0] - ends[k, 0], ends[n, 1] - ends[k, 1]) < sparse:
            return True
    return False


@njit(cache=True)
def _cross(seen: np.ndarray, x0: float, y0: float, x1: float, y1: float) -> None:
    """Marks the cells from (x0, y0) to before that of (x1, y1) as free where they are not hit (Amanatides and Woo)."""
    i, j, i_end, j_end = int(x0), int(y0), int(x1), int(y1)
    dx, dy = x1 - x0, y1 - y0
    step_i, step_j = 1 if dx > 0 else -1, 1 if dy > 0 else -1
    each_x = 1.0 / abs(dx) if dx != 0 else np.inf
    each_y = 1.0 / abs(dy) if dy != 0 else np.inf
    next_x = ((i + 1 - x0) if dx > 0 else (x0 - i)) * each_x if dx != 0 else np.inf
    next_y = ((j + 1 - y0) if dy > 0 else (y0 - j)) * each_y if dy != 0 else np.inf
    for _ in range(abs(i_end - i) + abs(j_end - j)):
        if seen[i, j] != _HIT:
            seen[i, j] = _FREE
        if next_x < next_y:
            i += step_i
            next_x += each_x
        else:
            j += step_j
            next_y += each_y
        if i < 0 or j < 0 or i >= seen.shape[0] or j >= seen.shape[1]:
            return


@njit(cache=True)
def surface_elements(log_odds: np.ndarray, hits: np.ndarray, i0: int, i1: int, j0: int, j1: int) -> np.ndarray:
    """Surface of the occupied cells that were hit: where and which way it faces, in cells, of rows i0 to i1, j0 to j1.

    An element lies on the line through the mean hits of the window of 7 × 7 cells around it, or of a smaller one where
    these make no line, and faces the laser. A post, a few cells alone that were hit often, and clutter face it
    squarely. All else is left out: where far beams graze a wall metres apart, nobody knows which way it faces.

    Returns:
        (n, 6): x, y of the mean hit, x, y of the unit normal, i, j of the cell.
    """
    result = np.empty((int((hits[i0:i1, j0:j1, 0] > 0.0).sum()), 6))
    k = 0
    for i in range(i0, i1):
        for j in range(j0, j1):
            if not (log_odds[i, j] > 0.0 and hits[i, j, 0] > 0.0):
                continue
            x, y = i + 0.5 + hits[i, j, 1] / hits[i, j, 0], j + 0.5 + hits[i, j, 2] / hits[i, j, 0]
            vx, vy = hits[i, j, 3], hits[i, j, 4]
            far = max(math.hypot(vx, vy), 1e-9)
            found, around = False, 0.0
            for scale in range(len(_WINDOWS)):
                n, beams, mx, my, a, b, c = _moments(log_odds, hits, i, j, _WINDOWS[scale])
                around = n if scale == 0 else around
                spread = 0.5 * math.hypot(a - c, 2.0 * b)
                least, most = 0.5 * (a + c) - spread, 0.5 * (a + c) + spread
                if n < _LEAST_CELLS[scale] or least > _STRAIGHT[scale] * most:
                    continue
                half = 0.5 * math.atan2(2.0 * b, a - c)
                normal_x, normal_y = -math.sin(half), math.cos(half)
                if normal_x * vx + normal_y * vy < 0.0:
                    normal_x, normal_y = -normal_x, -normal_y
                sure = beams * most > (_HIT_DEVIATION / _NORMAL_DEVIATION[scale]) ** 2
                if sure and normal_x * vx + normal_y * vy > _GRAZED * far:
                    off = (i + 0.5 + mx - x) * normal_x + (j + 0.5 + my - y) * normal_y
                    result[k, 0], result[k, 1] = x + off * normal_x, y + off * normal_y
                    result[k, 2], result[k, 3] = normal_x, normal_y
                    result[k, 4], result[k, 5] = i, j
                    k += 1
                found = True
                break
            if found or hits[i, j, 0] < _POST_HITS:
                continue
            if around >= _CLUTTER or (around <= 3.0 and _stands_alone(log_odds, i, j)):
                result[k, 0], result[k, 1] = x, y
                result[k, 2], result[k, 3] = vx / far, vy / far
                result[k, 4], result[k, 5] = i, j
                k += 1
    return result[:k]


@njit(cache=True)
def _moments(
    log_odds: np.ndarray, hits: np.ndarray, i: int, j: int, window: int
) -> tuple[float, float, float, float, float, float, float]:
    """Cells of a window with hits from this side, beams, mean hit from the cell's centre, its variances xx, xy, yy."""
    n, beams, sx, sy, sxx, sxy, syy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for p in range(max(i - window, 0), min(i + window + 1, log_odds.shape[0])):
        for q in range(max(j - window, 0), min(j + window + 1, log_odds.shape[1])):
            if log_odds[p, q] <= 0.0 or hits[p, q, 0] == 0.0:
                continue
            # The other face of a thin wall was seen from the other side.
            if hits[p, q, 3] * hits[i, j, 3] + hits[p, q, 4] * hits[i, j, 4] < 0.0:
                continue
            x, y = p - i + hits[p, q, 1] / hits[p, q, 0], q - j + hits[p, q, 2] / hits[p, q, 0]
            n += 1.0
            beams += hits[p, q, 0]
            sx += x
            sy += y
            sxx += x * x
            sxy += x * y
            syy += y * y
    mx, my = sx / n, sy / n
    return n, beams, mx, my, sxx / n - mx * mx, sxy / n - mx * my, syy / n - my * my


@njit(cache=True)
def _stands_alone(log_odds: np.ndarray, i: int, j: int) -> bool:
    """Whether nothing else is occupied around the window of a cell: a wall goes on, even where beams graze it."""
    for p in range(max(i - _ALONE, 0), min(i + _ALONE + 1, log_odds.shape[0])):
        for q in range(max(j - _ALONE, 0), min(j + _ALONE + 1, log_odds.shape[1])):
            if log_odds[p, q] > 0.0 and max(abs(p - i), abs(q - j)) > _WINDOWS[0]:
                return False
    return True


@njit(cache=True)
def spread_elements(
    elements: np.ndarray,
    owner: np.ndarray,
    signed: np.ndarray,
    source: np.ndarray,
    reach: float,
    i0: int,
    i1: int,
    j0: int,
    j1: int,
) -> None:
    """Writes the distance to the nearest surface element into the cells i0 to i1, j0 to j1 of a field, in place.

    An element is a short piece of line. In front of and behind it the distance is that to its line, which is linear, so
    that bilinear interpolation of it is exact on a straight wall. Beyond its ends it says nothing: where a wall has not
    been seen any farther, a beam that ends farther on is no reason to go back.

    Args:
        elements: (n, 6), of `surface_elements`. owner: (nx, ny) int32, of the grid.
        signed: (nx, ny) float32 [cells], positive where the laser was; `source`: (nx, ny) int32, owner of the nearest.
        reach: the distance is cut off there [cells].
    """
    wide = math.ceil(reach)
    for k in range(len(elements)):
        x, y, normal_x, normal_y = elements[k, 0], elements[k, 1], elements[k, 2], elements[k, 3]
        ci, cj = int(elements[k, 4]), int(elements[k, 5])
        who = owner[ci, cj]
        for i in range(max(ci - wide, i0), min(ci + wide + 1, i1)):
            for j in range(max(cj - wide, j0), min(cj + wide + 1, j1)):
                dx, dy = i + 0.5 - x, j + 0.5 - y
                front = normal_x * dx + normal_y * dy
                if abs(normal_x * dy - normal_y * dx) > _HALF:
                    continue
                if abs(front) < abs(signed[i, j]) and abs(front) < reach:
                    signed[i, j] = front
                    source[i, j] = who


@njit(cache=True, inline="always")
def look_up(signed: np.ndarray, x: float, y: float, reach: float) -> tuple[float, float, float]:
    """Bilinear distance at (x, y) [cells from the grid's corner] and its gradient; `reach` where it is not known."""
    u, v = x - 0.5, y - 0.5
    i, j = math.floor(u), math.floor(v)
    if i < 0 or j < 0 or i + 1 >= signed.shape[0] or j + 1 >= signed.shape[1]:
        return reach, 0.0, 0.0
    u, v = u - i, v - j
    a, b, c, d = signed[i, j], signed[i + 1, j], signed[i, j + 1], signed[i + 1, j + 1]
    if max(abs(a), abs(b), abs(c), abs(d)) >= 0.999 * reach:
        return reach, 0.0, 0.0
    low, high = a + u * (b - a), c + u * (d - c)
    return low + v * (high - low), (b - a) + v * ((d - c) - (b - a)), high - low
