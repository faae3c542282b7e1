"""Arithmetic of two tracks: twist to track speeds and back, and limits that keep the curvature."""

import numpy as np


def twist_to_track_speeds(speed: float, yaw_rate: float, gauge: float) -> np.ndarray:
    """Track speeds (left, right) [m/s] of a body that moves with `speed` [m/s] and turns with `yaw_rate` [rad/s].

    v_left = v − ω B/2 and v_right = v + ω B/2, where B is the effective gauge [m]: for tracks that scrub over the
    ground it is larger than their distance, see `skid_steer.effective_gauge`.
    """
    half = 0.5 * gauge * yaw_rate
    return np.array([speed - half, speed + half])


def track_speeds_to_twist(track_speeds: np.ndarray, gauge: float) -> np.ndarray:
    """The inverse of `twist_to_track_speeds`: (v [m/s], ω [rad/s]) of the speeds (left, right) [m/s]."""
    left, right = track_speeds
    return np.array([0.5 * (left + right), (right - left) / gauge])


def limit_track_speeds(track_speeds: np.ndarray, max_speed: float) -> np.ndarray:
    """Scales both speeds by one factor so that neither exceeds `max_speed` [m/s]; the path keeps its curvature."""
    largest = float(np.abs(track_speeds).max())
    return track_speeds * (max_speed / largest) if largest > max_speed else np.array(track_speeds, dtype=float)


def limit_track_acceleration(previous: np.ndarray, target: np.ndarray, max_change: float) -> np.ndarray:
    """Moves from `previous` towards `target` by at most `max_change` [m/s] on either track.

    Both tracks reach their targets at the same time, so a start from rest and a stop keep the curvature.
    """
    return previous + limit_track_speeds(np.subtract(target, previous), max_change)
