"""Compiled step of the drives of a snake."""

import numpy as np
from numba import njit


@njit(cache=True)
def drive_step(
    references: np.ndarray,
    angle: np.ndarray,
    rate: np.ndarray,
    joint_target: np.ndarray,
    wheel_speed: np.ndarray,
    torque: np.ndarray,
    gains: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    period: float,
    joint_max_rate: float,
    wheel_max_speed: float,
    wheel_max_acceleration: float,
) -> np.ndarray:
    """The references of the next period and what of them the control is given.

    Args:
        references: (4, m + w) of the last period: angles [rad], rates [rad/s], then what was given; m joints, w wheels.
        angle, rate: (m + w,) measured.
        joint_target: (m,) [rad]; not finite holds the joint. wheel_speed: (w,) [rad/s]; not finite counts as zero.
        torque: (m + w,) limits [N m]. gains: (2, m + w) of the control, p [N m/rad] and d [N m s/rad].
        lower, upper: (m,) ranges [rad].

    Returns:
        (4, m + w) as `references`. What is given is drawn towards what is measured until the control asks for no more
        than the limit of the torque.
    """
    m, n = joint_target.shape[0], angle.shape[0]
    new = np.empty((4, n))
    for j in range(n):
        if j < m:
            before, target = references[0, j], joint_target[j]
            if not np.isfinite(target):
                target = before
            step = min(
                max(min(max(target, lower[j]), upper[j]) - before, -joint_max_rate * period), joint_max_rate * period
            )
            new[0, j], new[1, j] = before + step, step / period
        else:
            speed = wheel_speed[j - m]
            if not np.isfinite(speed):
                speed = 0.0
            speed = min(max(speed, -wheel_max_speed), wheel_max_speed)
            change = wheel_max_acceleration * period
            new[1, j] = references[1, j] + min(max(speed - references[1, j], -change), change)
            lead = torque[j] / gains[0, j]
            new[0, j] = min(max(references[0, j], angle[j] - lead), angle[j] + lead) + period * new[1, j]
        # The reference is that of the next sample, so it is compared with where the joint will be by then.
        then = angle[j] + period * rate[j]
        asked = abs(gains[0, j] * (new[0, j] - then) + gains[1, j] * (new[1, j] - rate[j]))
        share = torque[j] / asked if asked > torque[j] else 1.0
        new[2, j] = then + share * (new[0, j] - then)
        new[3, j] = rate[j] + share * (new[1, j] - rate[j])
    return new
