"""Compiled fitting of the body to a path, which is what shift control does at every step (row S1-c)."""

import numpy as np
from numba import njit


@njit(cache=True)
def point_on(points: np.ndarray, lengths: np.ndarray, s: float, out: np.ndarray) -> None:
    """Writes the point (3,) at arc length `s` [m] of the polyline `points` (N, 3); straight on beyond its ends.

    Args:
        lengths: (N,) arc lengths of the points, from 0, strictly rising.
    """
    i = min(max(int(np.searchsorted(lengths, s)) - 1, 0), len(lengths) - 2)
    f = (s - lengths[i]) / (lengths[i + 1] - lengths[i])
    for r in range(3):
        out[r] = points[i, r] + f * (points[i + 1, r] - points[i, r])


@njit(cache=True)
def _distance(points: np.ndarray, lengths: np.ndarray, s: float, p: np.ndarray, q: np.ndarray) -> float:
    point_on(points, lengths, s, q)
    return np.sqrt((q[0] - p[0]) ** 2 + (q[1] - p[1]) ** 2 + (q[2] - p[2]) ** 2)


@njit(cache=True)
def chord_behind(
    points: np.ndarray, lengths: np.ndarray, s: float, p: np.ndarray, chord: float, q: np.ndarray
) -> float:
    """The nearest arc length behind `s` at which the path is `chord` [m] away from `p`; writes the point there."""
    step = chord / 16.0
    low = s - chord * 0.5
    while _distance(points, lengths, low, p, q) < chord and low > s - 20.0 * chord:
        low -= step
    high = low + step
    for _ in range(50):
        middle = 0.5 * (low + high)
        if _distance(points, lengths, middle, p, q) > chord:
            low = middle
        else:
            high = middle
    point_on(points, lengths, low, q)
    return low


@njit(cache=True)
def _turn_pitch(R: np.ndarray, angle: float) -> None:
    c, s = np.cos(angle), np.sin(angle)
    for r in range(3):
        R[r, 0], R[r, 2] = c * R[r, 0] - s * R[r, 2], s * R[r, 0] + c * R[r, 2]


@njit(cache=True)
def _turn_yaw(R: np.ndarray, angle: float) -> None:
    c, s = np.cos(angle), np.sin(angle)
    for r in range(3):
        R[r, 0], R[r, 1] = c * R[r, 0] + s * R[r, 1], c * R[r, 1] - s * R[r, 0]


@njit(cache=True)
def fit_body(
    points: np.ndarray,
    lengths: np.ndarray,
    s: float,
    R: np.ndarray,
    half_length: float,
    angles: np.ndarray,
    axles: np.ndarray,
    frames: np.ndarray,
) -> None:
    """Joint angles of n units whose wheels run on the path, the first axle at arc length `s` [m].

    From axle to axle, the pitch joint puts the next axle on the path, and the yaw joint gives the link there the
    direction of the path, measured over half a unit to both sides. On the line through the joints of a body this gives
    back its angles, and a whole unit further on the angles of the unit in front. (A yaw joint that puts the axles on
    the path exactly would swing: an error of a link's heading comes back with the opposite sign in the next one.)

    Args:
        R: (3, 3) attitude of the link in front of the first pitch joint; turned to that of the last link.
        angles: (2 n - 1,) is written, p0, y0, p1, ... [rad].
        axles, frames: (n, 3) [m] and (n, 3, 3) are written: the axles and the attitudes of the links in front of them.
    """
    units = axles.shape[0]
    p, q, ahead, behind = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    start = np.empty((3, 3))
    point_on(points, lengths, s, p)
    yaw = 0.0
    for i in range(units):
        axles[i], frames[i] = p, R
        if i == units - 1:
            point_on(points, lengths, s - half_length, q)
            d0, d1, d2 = p[0] - q[0], p[1] - q[1], p[2] - q[2]
            x = d0 * R[0, 0] + d1 * R[1, 0] + d2 * R[2, 0]
            z = d0 * R[0, 2] + d1 * R[1, 2] + d2 * R[2, 2]
            angles[2 * i] = np.arctan2(-z, x)
            _turn_pitch(R, angles[2 * i])
            break
        start[:] = R
        s_next = s
        for _ in range(10):  # the chord shortens with the yaw angle, which it determines
            R[:] = start
            s_next = chord_behind(points, lengths, s, p, 2.0 * half_length * np.cos(0.5 * yaw), q)
            d0, d1, d2 = p[0] - q[0], p[1] - q[1], p[2] - q[2]
            x = d0 * R[0, 0] + d1 * R[1, 0] + d2 * R[2, 0]
            z = d0 * R[0, 2] + d1 * R[1, 2] + d2 * R[2, 2]
            pitch = np.arctan2(-z, x)
            _turn_pitch(R, pitch)
            point_on(points, lengths, s_next + half_length, ahead)
            point_on(points, lengths, s_next - half_length, behind)
            d0, d1, d2 = ahead[0] - behind[0], ahead[1] - behind[1], ahead[2] - behind[2]
            x = d0 * R[0, 0] + d1 * R[1, 0] + d2 * R[2, 0]
            y = d0 * R[0, 1] + d1 * R[1, 1] + d2 * R[2, 1]
            before, yaw = yaw, np.arctan2(y, x)
            if abs(yaw - before) < 1e-8:
                break
        angles[2 * i], angles[2 * i + 1] = pitch, yaw
        for r in range(3):
            p[r] -= half_length * R[r, 0]
        _turn_yaw(R, yaw)
        for r in range(3):
            p[r] -= half_length * R[r, 0]
        s = s_next
