"""What odometry, a scan and a map that was made on the way leave unknown of a planar pose."""

import math
from dataclasses import dataclass

import numpy as np

from ..config import quantity
from .planar import compose, turned


@dataclass(kw_only=True)
class PlanarOdometryAccuracy:
    """Deviations of odometry, as those of a random walk: they grow with the root of the way.

    A wheel whose radius is off by s errs by s · way, not by its root: over the ways between two landmarks, d, the
    values here cover it when they are above s · √d.
    """

    # [m/√m] Along and across the way.
    along: float = quantity(0.05, unit="m/√m", above=0)
    across: float = quantity(0.02, unit="m/√m", above=0)
    # [deg/√m], [deg/√rad] Of the heading.
    heading_deg: float = quantity(1.0, unit="deg/√m", above=0)
    turn_deg: float = quantity(2.0, unit="deg/√rad", above=0)


def odometry_step_covariance(step: np.ndarray, accuracy: PlanarOdometryAccuracy) -> np.ndarray:
    """Covariance of a step X_BB' (3,) in the axes of B, (3, 3) [m, m, rad]."""
    way, turn = math.hypot(step[0], step[1]), abs(step[2])
    heading = math.radians(accuracy.heading_deg) ** 2 * way + math.radians(accuracy.turn_deg) ** 2 * turn
    axes = np.diag([accuracy.along**2 * way, accuracy.across**2 * way, heading])
    return turned(axes, math.atan2(step[1], step[0])) if way > 0 else axes


def predict(
    X_MB: np.ndarray, covariance: np.ndarray, step: np.ndarray, accuracy: PlanarOdometryAccuracy
) -> tuple[np.ndarray, np.ndarray]:
    """Pose and covariance, in the axes of M, after a step X_BB' of odometry."""
    after = compose(X_MB, step)
    F = np.eye(3)
    F[0, 2], F[1, 2] = X_MB[1] - after[1], after[0] - X_MB[0]
    Q = turned(odometry_step_covariance(step, accuracy), X_MB[2])
    return after, F @ covariance @ F.T + Q


def information_of(A: np.ndarray, T: np.ndarray, normal_deviation: float) -> np.ndarray:
    """What a scan tells of the pose, (3, 3), with walls that are not quite straight in the map.

    A = Σ j jᵀ / σ² is made of normals that are off by some angle ε, and j of j + ε t, t the normal turned by 90°. So A
    is too large by ε² T on average: a bare wall seems to tell where along it the robot is. This is taken off, and what
    is left below zero is zero.

    Args:
        A, T: as from `normal_equations`. normal_deviation: of ε [rad].
    """
    rest = A - normal_deviation**2 * T
    # In units of 1 m and 1 m / (typical lever) the axes are alike; without it the turn would rule.
    scale = np.array([1.0, 1.0, math.sqrt(max((A[0, 0] + A[1, 1]) / max(2 * A[2, 2], 1e-12), 1e-12))])
    values, vectors = np.linalg.eigh(rest * np.outer(scale, scale))
    clipped = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return clipped / np.outer(scale, scale)


def surprise(covariance: np.ndarray, information: np.ndarray, offset: np.ndarray) -> float:
    """eᵀ (P + Ω⁻¹)⁻¹ e of an offset e between prior and scan, chi-square distributed with up to 3 degrees of freedom.

    With Ω = 0 in a direction it does not count: P⁻¹ - P⁻¹ (P⁻¹ + Ω)⁻¹ P⁻¹ is the same.
    """
    prior = np.linalg.inv(covariance)
    return float(offset @ (prior - prior @ np.linalg.solve(prior + information, prior)) @ offset)


def fuse(covariance: np.ndarray, information: np.ndarray, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How much of an offset (3,) between prior and scan is believed, and the covariance after that."""
    after = np.linalg.inv(np.linalg.inv(covariance) + information)
    after = 0.5 * (after + after.T)
    return after @ information @ offset, after


def the_lower(P: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """The covariance of which each direction, where P and Q are both diagonal, is the smaller of the two.

    For two estimates of the same pose whose errors are not independent, such as dead reckoning and a map that was made
    while dead reckoning: one of them is taken, nothing is averaged away.
    """
    L = np.linalg.cholesky(P)
    ratio = np.linalg.solve(L, np.linalg.solve(L, Q).T)
    values, vectors = np.linalg.eigh(0.5 * (ratio + ratio.T))
    half = L @ vectors * np.sqrt(np.clip(values, 0.0, 1.0))
    return half @ half.T
