"""Compiled Fisher information of a laser scan: what a scan tells of x, y and heading, and what a box adds to that.

Information matrices of (x, y, heading) are held as their upper triangles xx, xy, xθ, yy, yθ, θθ [1/m², 1/m, -].
"""

import math

import numpy as np
from numba import njit

from .ray_kernels import cast_ray

# [-] A jump between neighbouring ranges of more than this, times the range, is an edge.
_JUMP = 0.15


@njit(cache=True)
def _add(info: np.ndarray, a: float, b: float, c: float, weight: float) -> None:
    """Adds weight · J Jᵀ of the residual a dx + b dy + c dθ."""
    info[0] += weight * a * a
    info[1] += weight * a * b
    info[2] += weight * a * c
    info[3] += weight * b * b
    info[4] += weight * b * c
    info[5] += weight * c * c


@njit(cache=True)
def _add_face(info: np.ndarray, angle: float, r: float, normal: float, noise: np.ndarray, rays: float) -> None:
    """A ray of length `r` [m] at `angle` that meets a face with the normal's direction `normal` [rad]."""
    nx, ny = math.cos(normal), math.sin(normal)
    dx, dy = math.cos(angle), math.sin(angle)
    slant = nx * dx + ny * dy
    variance = (noise[0] * slant) ** 2 + noise[1] ** 2
    _add(info, nx, ny, r * (ny * dx - nx * dy), rays / variance)


@njit(cache=True)
def _add_edge(info: np.ndarray, angle: float, r: float, noise: np.ndarray, spacing: float) -> None:
    """An edge at `angle` and `r` [m], found to within the spacing [rad] of the rays."""
    dx, dy = math.cos(angle), math.sin(angle)
    variance = (r * spacing) ** 2 / 12.0 + noise[1] ** 2
    _add(info, -dy, dx, r, 1.0 / variance)


@njit(cache=True)
def _wrapped(angle: float) -> float:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@njit(cache=True)
def scan_information(
    occupied: np.ndarray,
    directions: np.ndarray,
    cell: float,
    poses: np.ndarray,
    sites: np.ndarray,
    side: float,
    laser: np.ndarray,
    noise: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Information of the scans at poses, and what a box at each site adds to it.

    A box adds its faces and its two edges, and takes what it hides of the walls; what is less than nothing of that is
    left out, so that no box makes a scan worse. That boxes hide each other is left out too.

    Args:
        directions: (rows, cols) in which the walls run [rad], see `wall_directions`.
        cell: [m]. poses: (n, 3) x, y from the plan's corner [m], heading. sites: (k, 2) from the plan's corner [m].
        side: of a box [m].
        laser: field of view [rad], range [m], spacing of the rays [rad], spacing of those that are cast [rad].
        noise: of ranges, of the map [m], and the share of the rays that count.

    Returns:
        (n, 6) and (n, k, 6).
    """
    base = np.zeros((len(poses), 6))
    added = np.zeros((len(poses), len(sites), 6))
    view, reach, spacing, cast = laser[0], laser[1], laser[2], laser[3]
    count = int(view / cast) + 1
    per_cast = noise[2] * cast / spacing
    ranges = np.empty(count)
    ray = np.empty((count, 6))
    for p in range(len(poses)):
        x, y, heading = poses[p, 0], poses[p, 1], poses[p, 2]
        for k in range(count):
            angle = heading - 0.5 * view + k * cast
            r, i, j = cast_ray(occupied, x / cell, y / cell, math.cos(angle), math.sin(angle), reach / cell)
            ranges[k] = r * cell
            ray[k] = 0.0
            if i >= 0 and not math.isnan(directions[i, j]):
                _add_face(ray[k], angle, ranges[k], directions[i, j] + 0.5 * math.pi, noise, per_cast)
            base[p] += ray[k]
            if k > 0 and min(ranges[k], ranges[k - 1]) < reach:
                near, far = min(ranges[k], ranges[k - 1]), max(ranges[k], ranges[k - 1])
                # What ends at the laser's range is no edge.
                if far < np.inf and far - near > _JUMP * near + 0.3:
                    at = angle if ranges[k] < ranges[k - 1] else angle - cast
                    _add_edge(base[p], at, near, noise, spacing)
        for s in range(len(sites)):
            _add_box(
                added[p, s], x, y, heading, sites[s], side, view, reach, spacing, cast, noise, ranges, ray, per_cast
            )
    return base, added


@njit(cache=True)
def _add_box(
    info: np.ndarray,
    x: float,
    y: float,
    heading: float,
    site: np.ndarray,
    side: float,
    view: float,
    reach: float,
    spacing: float,
    cast: float,
    noise: np.ndarray,
    ranges: np.ndarray,
    ray: np.ndarray,
    per_cast: float,
) -> None:
    dx, dy = site[0] - x, site[1] - y
    half = 0.5 * side
    if math.hypot(dx, dy) > reach + side or max(abs(dx), abs(dy)) <= half:
        return
    towards = math.atan2(dy, dx)
    low, high, at_low, at_high = np.inf, -np.inf, 0.0, 0.0
    for u in (-half, half):
        for v in (-half, half):
            away = _wrapped(math.atan2(dy + v, dx + u) - towards)
            if away < low:
                low, at_low = away, math.hypot(dx + u, dy + v)
            if away > high:
                high, at_high = away, math.hypot(dx + u, dy + v)
    seen = False
    rays = max(1, round((high - low) / spacing))
    for k in range(rays):
        angle = towards + low + (k + 0.5) * (high - low) / rays
        off = _wrapped(angle - heading)
        if abs(off) > 0.5 * view:
            continue
        behind = min(max(round((off + 0.5 * view) / cast), 0), len(ranges) - 1)
        r, normal = _box_range(dx, dy, half, angle)
        if r > reach or r > ranges[behind]:
            continue
        seen = True
        _add_face(info, angle, r, normal, noise, noise[2] * (high - low) / rays / spacing)
        for n in range(6):
            info[n] -= ray[behind, n] * (high - low) / rays / cast
    if not seen:
        return
    _clip(info)
    for away, r in ((low, at_low), (high, at_high)):
        off = _wrapped(towards + away - heading)
        if abs(off) <= 0.5 * view and r <= reach:
            behind = min(max(round((off + 0.5 * view) / cast), 0), len(ranges) - 1)
            if r < ranges[behind]:
                _add_edge(info, towards + away, r, noise, spacing)


@njit(cache=True)
def _box_range(dx: float, dy: float, half: float, angle: float) -> tuple[float, float]:
    """Range to the box centred at dx, dy along a ray that meets it, and the direction of the face's normal [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    tx = (dx - math.copysign(half, c)) / c if abs(c) > 1e-12 else -np.inf
    ty = (dy - math.copysign(half, s)) / s if abs(s) > 1e-12 else -np.inf
    return (tx, 0.0) if tx > ty else (ty, 0.5 * math.pi)


@njit(cache=True)
def _clip(info: np.ndarray) -> None:
    """Sets the negative eigenvalues of an information matrix to 0."""
    full = np.empty((3, 3))
    full[0, 0], full[1, 1], full[2, 2] = info[0], info[3], info[5]
    full[0, 1], full[1, 0] = info[1], info[1]
    full[0, 2], full[2, 0] = info[2], info[2]
    full[1, 2], full[2, 1] = info[4], info[4]
    values, vectors = np.linalg.eigh(full)
    if values[0] >= 0.0:
        return
    info[:] = 0.0
    for k in range(3):
        if values[k] > 0.0:
            _add(info, vectors[0, k], vectors[1, k], vectors[2, k], values[k])
