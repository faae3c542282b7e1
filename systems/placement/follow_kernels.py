"""Compiled evaluation of a route with a set of landmarks: the expected error along it, and the paper's count of sides.

A route is an order of the measuring points 1 … n, from the start 0. A leg from a to b has the number a (n + 1) + b; its
poses or nodes are those from first[leg] to first[leg + 1]. A set of landmarks is a word with a bit for every site.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

Word = int | np.int64


class Tables(NamedTuple):
    """What `follow` knows of all legs.

    Attributes:
        lengths: (n + 1, n + 1) of the legs [m].
        first: ((n + 1)² + 1,) where each leg's poses begin.
        poses: (p, 4) x, y, heading, and the length driven since the pose before [m, m, rad, m].
        base, added: information of the scans (p, 6), and what a box at each site adds (p, k, 6).
        limit: (p,) largest error that is allowed at each pose [m].
        odometry: (4,) variances along and across per metre, of the heading per metre, and per radian turned.
        at_start: (4,) variance of the position, of the heading, the start's heading, and the number of standard
            deviations that count as the largest error.
    """

    lengths: np.ndarray
    first: np.ndarray
    poses: np.ndarray
    base: np.ndarray
    added: np.ndarray
    limit: np.ndarray
    odometry: np.ndarray
    at_start: np.ndarray


class Sides(NamedTuple):
    """What the paper's Eval knows of all legs.

    Attributes:
        first_node: ((n + 1)² + 1,) where each leg's nodes begin.
        left, right: (m,) whether the plan's own landmarks are seen on that side of a node.
        left_sites, right_sites: (m,) words with the sites that are.
        penalty: (m,) that a node costs for each side without a landmark; not 0 where a run has failed.
    """

    first_node: np.ndarray
    left: np.ndarray
    right: np.ndarray
    left_sites: np.ndarray
    right_sites: np.ndarray
    penalty: np.ndarray


@njit(cache=True)
def route_length(order: np.ndarray, lengths: np.ndarray) -> float:
    """Length [m] of a route; lengths: (n + 1, n + 1)."""
    total, at = 0.0, 0
    for k in range(len(order)):
        total += lengths[at, order[k]]
        at = order[k]
    return total


@njit(cache=True)
def follow(order: np.ndarray, chosen: Word, tables: Tables, errors: np.ndarray) -> tuple[float, float, int]:
    """Follows the covariance of the pose along a route, as a Kalman filter does that has all the scans tell.

    Args:
        errors: (m,) is filled with the error at each pose in turn [m], as far as it is long.

    Returns:
        Excess: sum of (error / limit - 1) over poses where that is positive, times the length driven [m].
        Mean of error / limit over the length driven. Number of poses.
    """
    first, poses, base, added, limit = tables.first, tables.poses, tables.base, tables.added, tables.limit
    odometry, at_start = tables.odometry, tables.at_start
    n = len(tables.lengths)
    sites = added.shape[1]
    xx, xy, xt, yy, yt, tt = at_start[0], 0.0, 0.0, at_start[0], 0.0, at_start[1]
    heading, sigmas = at_start[2], at_start[3]
    chosen_sites = np.empty(sites, np.int64)
    count = 0
    for site in range(sites):
        if (chosen >> site) & 1:
            chosen_sites[count] = site
            count += 1
    excess, share, driven, k, at = 0.0, 0.0, 0.0, 0, 0
    for o in range(len(order)):
        leg = at * n + order[o]
        at = order[o]
        for p in range(first[leg], first[leg + 1]):
            step = poses[p, 3]
            turn = abs((poses[p, 2] - heading + math.pi) % (2.0 * math.pi) - math.pi)
            heading = poses[p, 2]
            c, s = math.cos(heading), math.sin(heading)
            tt += odometry[3] * turn
            a, b = -step * s, step * c
            xx += 2.0 * a * xt + a * a * tt + step * (odometry[0] * c * c + odometry[1] * s * s)
            xy += a * yt + b * xt + a * b * tt + step * (odometry[0] - odometry[1]) * c * s
            yy += 2.0 * b * yt + b * b * tt + step * (odometry[0] * s * s + odometry[1] * c * c)
            xt += a * tt
            yt += b * tt
            tt += odometry[2] * step
            jxx, jxy, jxt, jyy, jyt, jtt = _inverse(xx, xy, xt, yy, yt, tt)
            jxx += base[p, 0]
            jxy += base[p, 1]
            jxt += base[p, 2]
            jyy += base[p, 3]
            jyt += base[p, 4]
            jtt += base[p, 5]
            for m in range(count):
                more = added[p, chosen_sites[m]]
                jxx += more[0]
                jxy += more[1]
                jxt += more[2]
                jyy += more[3]
                jyt += more[4]
                jtt += more[5]
            xx, xy, xt, yy, yt, tt = _inverse(jxx, jxy, jxt, jyy, jyt, jtt)
            largest = 0.5 * (xx + yy + math.hypot(xx - yy, 2.0 * xy))
            error = sigmas * math.sqrt(max(largest, 0.0))
            if k < len(errors):
                errors[k] = error
            k += 1
            excess += step * max(0.0, error / limit[p] - 1.0)
            share += step * error / limit[p]
            driven += step
    return excess, share / max(driven, 1e-9), k


@njit(cache=True)
def _inverse(
    a: float, b: float, c: float, d: float, e: float, f: float
) -> tuple[float, float, float, float, float, float]:
    """Upper triangle of the inverse of the symmetric matrix a b c; b d e; c e f."""
    p, q, r = d * f - e * e, c * e - b * f, b * e - c * d
    over = 1.0 / (a * p + b * q + c * r)
    return over * p, over * q, over * r, over * (a * f - c * c), over * (b * c - a * e), over * (a * d - b * b)


@njit(cache=True)
def sides_seen(order: np.ndarray, chosen: Word, n: int, sides: Sides) -> float:
    """Mean of the paper's Eval over the nodes of a route, Eq. 3: 0 where no landmark is seen, 1 where some are on one
    side, 2 where there are on both; less the penalties, but not less than 0.

    Args:
        n: number of points, the start among them.
    """
    first = sides.first_node
    total, count, at = 0.0, 0, 0
    for o in range(len(order)):
        leg = at * n + order[o]
        at = order[o]
        for k in range(first[leg], first[leg + 1]):
            total += 1.0 if sides.left[k] or (sides.left_sites[k] & chosen) != 0 else -sides.penalty[k]
            total += 1.0 if sides.right[k] or (sides.right_sites[k] & chosen) != 0 else -sides.penalty[k]
        count += first[leg + 1] - first[leg]
    return max(0.0, total) / max(count, 1)


@njit(cache=True)
def bits_set(word: Word) -> int:
    """Number of bits of a word that are 1."""
    n = 0
    while word != 0:
        word &= word - 1
        n += 1
    return n
