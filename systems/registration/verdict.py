"""From how clouds lie on each other to a result: what to believe, how exactly, and whether at all."""

import numpy as np
from pydrake.math import RigidTransform

from .alignment import Alignment
from .config import RegistrationConfig
from .constraint import motion_from, moved
from .result import Axis, Registration, rejected

# With this much constraint in its weakest direction, the health of a registration is its fitness.
GOOD_CONSTRAINT = 0.03


def agreement(alignment: Alignment, config: RegistrationConfig) -> float:
    """How well the clouds fit, [0, 1], to compare poses: fitness, and less where sensors saw through surfaces."""
    if alignment.contradiction is None:
        return alignment.fitness
    # Never quite nothing, so that among bad poses the better fit counts.
    return alignment.fitness * max(1 - alignment.contradiction / config.max_contradiction, 1e-3)


def fits(alignment: Alignment, config: RegistrationConfig) -> bool:
    """Whether an alignment fits so well that no other is looked for."""
    if alignment.contradiction is None:
        return alignment.fitness >= config.retry_fitness
    return alignment.contradiction <= 0.5 * config.max_contradiction or config.retry_fitness == 0


def judge(
    alignment: Alignment,
    X_TS_guess: RigidTransform,
    guess_covariance: np.ndarray | None,
    config: RegistrationConfig,
) -> Registration:
    """Weighs what surfaces, classes and guess say along every motion, and rejects what cannot be right.

    Surfaces that feel the part λ of a motion know it with the variance σ²/(n λ), n the number of independent ones;
    where λ is below `min_constraint`, they are not asked. Classes and the guess have covariances of their own. The
    result is where the sum of all three squared deviations is least.
    """
    a, hold = alignment, alignment.hold
    if hold is None or a.surfaces < config.fewest:
        return rejected(X_TS_guess, f"no overlap: {a.surfaces} points on surfaces, needs {config.fewest}")
    if a.contradiction is not None and a.contradiction > config.max_contradiction:
        seen_through = (
            f"{a.contradiction:.0%} of the surfaces were seen through, at most {config.max_contradiction:.0%}"
        )
        return rejected(X_TS_guess, f"contradiction: {seen_through} is right")
    if a.contradiction is None and a.fitness < config.min_fitness:
        return rejected(X_TS_guess, f"too little overlap: fitness {a.fitness:.2f}, needs {config.min_fitness:g}")
    felt = np.maximum(hold.values - a.tilt, 0.0)
    held = felt >= config.min_constraint
    information = np.diag(np.where(held, felt / max(a.variance, 1e-12), 0.0))
    by_class = np.zeros(6, bool)
    if a.fix is not None and a.fix.distinct and np.count_nonzero(~held) == len(a.fix.offsets):
        by_class = ~held
        information[np.ix_(by_class, by_class)] = np.linalg.inv(a.fix.covariance)
    to_origin = hold.at_point(a.X_TS.translation())
    if guess_covariance is None:
        prior = np.diag(np.where(held | by_class, 0.0, config.free_deviation**-2))
    else:
        prior = to_origin.T @ np.linalg.inv(guess_covariance) @ to_origin
        # The classes have weighed the guess in already.
        prior[by_class] = prior[:, by_class] = 0.0
    covariance = np.linalg.inv(information + prior)
    X_TS = moved(a.X_TS, hold, covariance @ prior @ motion_from(a.X_TS, X_TS_guess, hold))

    correction = X_TS_guess.inverse() @ X_TS
    distance = float(np.linalg.norm(correction.translation()))
    angle = np.rad2deg(abs(correction.rotation().ToAngleAxis().angle()))
    if distance > config.max_correction or angle > config.max_correction_deg:
        return rejected(X_TS_guess, f"jump of {distance:.2f} m, {angle:.0f} deg from the guess")

    sources = np.where(held, "geometry", np.where(by_class, "classes", "guess"))
    deviations = np.sqrt(np.diag(covariance))
    axes = tuple(Axis(hold.motions[:, i], str(sources[i]), float(deviations[i]), float(felt[i])) for i in range(6))
    reason = ""
    if not held.all():
        reason = f"the geometry does not hold {hold.names(~held)}: taken from the {sources[~held][0]}"
    weakest = float(np.where(by_class, GOOD_CONSTRAINT, felt).min())
    health = min(agreement(a, config) * min(weakest / GOOD_CONSTRAINT, 1.0), 1.0)
    covariance = to_origin @ covariance @ to_origin.T
    return Registration(X_TS, covariance, a.fitness, a.rmse, a.inliers, axes, health, True, reason)
