"""Polar histogram of risk: in which directions the ground ahead can be driven over (row S3-c)."""

from dataclasses import dataclass

import numpy as np

from .ability import Ability
from .features import TerrainFeatureTable
from .risk_map import IMPASSABLE

# Why a rectangle cannot be driven over.
PASSABLE, TOO_RISKY, TOO_HIGH, STEP, UNSEEN = range(5)
REASONS = ("passable", "too risky", "too high", "step", "unseen")


@dataclass(frozen=True, eq=False)
class RiskHistogram:
    """Risk of K rectangles, from right to left. Read-only.

    Attributes:
        directions: θ_k in H, left is positive, (K,) [rad].
        risk: r = 1/τ, `IMPASSABLE` where a threshold of the robot is exceeded or too little was seen, (K,).
        passable: r < r_limit, (K,) bool.
        reason: index into `REASONS`, (K,) int.
        far_edges: midpoints of the far edges in H, (K, 2) [m].
    """

    directions: np.ndarray
    risk: np.ndarray
    passable: np.ndarray
    reason: np.ndarray
    far_edges: np.ndarray

    def __deepcopy__(self, memo: dict) -> "RiskHistogram":
        return self


def make_histogram(features: TerrainFeatureTable, traversability: np.ndarray, ability: Ability) -> RiskHistogram:
    """Turns traversability τ (K,) into risk r = 1/τ and rules out what `ability` cannot drive over.

    The thresholds are those of `Ability`: share of the rectangle that was seen, mean height z_th (the paper's gate),
    step. The first of these that fails is the reason.
    """
    tau = np.asarray(traversability, float)
    with np.errstate(divide="ignore", invalid="ignore"):
        risk = np.minimum(np.where(tau > 0, 1 / tau, IMPASSABLE), IMPASSABLE)
    unseen = ~(features.coverage >= ability.min_coverage) | ~np.isfinite(features.mean_height)
    high, step = features.mean_height > ability.height_threshold, features.step_height > ability.step_threshold
    risk[unseen | high | step] = IMPASSABLE
    passable = risk < ability.risk_limit
    reason = np.select([unseen, high, step, ~passable], [UNSEEN, TOO_HIGH, STEP, TOO_RISKY], PASSABLE)
    return RiskHistogram(features.directions, risk, passable, reason, features.far_edges)
