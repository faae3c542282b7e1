"""Where along a motion that the geometry does not hold: what the classes of the surfaces say."""

from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform

from ..errors import InputError
from .class_lanes import Floats
from .class_peak import ClassCorrelationConfig
from .class_search import Search, pose_along, search_one, search_two


@dataclass(frozen=True, eq=False)
class ClassFix:
    """What `correlate_classes` found.

    Attributes:
        offsets: along every free motion, (m,), in its own unit; NaN when it is not distinct: there is no made-up zero.
        covariance: (m, m) of the offsets; infinite on the diagonal when it is not distinct.
        distinct: there is one peak, it lies inside the interval, and it stands out against the next and against chance.
        contrast: standard deviations by which the peak beats its best rival; 0 without a peak.
        evidence: log likelihood ratio of the peak against clouds that have nothing to do with each other [nats].
        reason: why it is not distinct, else "".
    """

    offsets: np.ndarray
    covariance: np.ndarray
    distinct: bool
    contrast: float
    evidence: float
    reason: str = ""


def moved_along(X_TS: RigidTransform, motions: np.ndarray, offsets: np.ndarray, centre: np.ndarray) -> RigidTransform:
    """The pose X_TS after `offsets` (m,) along `motions` (m, 6) about the point `centre` (3,) in T, the last one first.

    An offset goes along its motion for as long: a turn about an axis stays one (the exponential of the twist).
    """
    for motion, offset in zip(motions[::-1], offsets[::-1], strict=True):
        X_TS = pose_along(motion, float(offset), centre) @ X_TS
    return X_TS


def correlate_classes(
    p_TS: np.ndarray,
    prob_S: np.ndarray,
    p_TT: np.ndarray,
    prob_T: np.ndarray,
    shares: np.ndarray,
    motions: np.ndarray,
    span: float = 1.5,
    *,
    centre: np.ndarray | None = None,
    deviations: np.ndarray | None = None,
    expected: np.ndarray | None = None,
    config: ClassCorrelationConfig | None = None,
) -> ClassFix:
    """Finds the offsets along free motions at which the classes of two clouds agree.

    Both clouds are cut into lanes along the motion, and at every offset in the interval the cells that fall on each
    other are compared: log Σ_k p_k q_k / π_k, less what cells with these probabilities give on average with any others
    (both means of the table taken out), so that an offset gains nothing by having more overlap, and divided by what
    the overlap would give by chance. Looking for each point's nearest partner instead is pulled to zero motion,
    where the same rings lie on the same places. How the peak and its rivals differ from block to block of the surface
    says how sure it is, also when labels are wrong in whole spots; the covariance is that of an M-estimator, from the
    blocks' slopes at the peak. Errors that ride with the sensor (dirt on its window) do look like no motion.

    Args:
        p_TS: points of the source at its present pose, in T, (N, 3) [m].
        prob_S: their class probabilities (N, K), rows sum to 1.
        p_TT, prob_T: points of the target (M, 3) [m] and their class probabilities (M, K).
        shares: share of every class, (K,); a point whose class is not known has these as its probabilities.
        motions: (m, 6), m = 1 or 2: turn [rad] and shift [m] of a unit offset, about and along T's axes, of the point
            `centre`. (`constraint` has columns, with turns in units of 1/r: transpose, and divide the turns by r.)
        span: search interval ±span [m], as the source's points move (root mean square); not more than half a turn.
        centre: (3,); centroid of p_TS when not given.
        deviations: standard deviations (m,) of the offsets around `expected` (m,; zero when not given), in their own
            units, as a prior; none when not given.

    Raises:
        InputError: the arrays do not fit each other.
    """
    config = config or ClassCorrelationConfig()
    motions = np.atleast_2d(np.asarray(motions, float))
    count = len(motions)
    if motions.shape not in ((1, 6), (2, 6)):
        raise InputError("cannot correlate these motions", key="motions", value=motions.shape, valid="(1, 6) or (2, 6)")
    p_TS, prob_S = _checked(p_TS, prob_S, "source")
    p_TT, prob_T = _checked(p_TT, prob_T, "target")
    if prob_S.shape[1] != prob_T.shape[1] or prob_S.shape[1] != len(shares):
        raise InputError(
            "numbers of classes differ", key="shares", value=len(shares), valid=f"{prob_S.shape[1]}, {prob_T.shape[1]}"
        )
    if not len(p_TS) or not len(p_TT):
        return _nothing(count, "a cloud is empty")
    shares = np.asarray(shares, float)
    shares = np.clip(shares, 1e-6, None) / np.clip(shares, 1e-6, None).sum()
    centre = np.einsum("ij->j", p_TS) / len(p_TS) if centre is None else np.asarray(centre, float)
    # From here on, offsets are in metres of root mean square movement.
    speeds = np.array([_speed(motion, p_TS - centre) for motion in motions])
    twists = motions / speeds[:, None]
    with np.errstate(divide="ignore"):
        weights = np.zeros(count) if deviations is None else 1 / (np.asarray(deviations, float) * speeds) ** 2
    means = np.zeros(count) if expected is None else np.asarray(expected, float) * speeds
    search = Search(prob_S, p_TT, prob_T, shares, twists, centre, weights, means, config)
    found = search_one(search, p_TS, span) if count == 1 else search_two(search, p_TS, span)
    if found.reason:
        return _nothing(count, found.reason, found.contrast, found.evidence)
    covariance = found.covariance / np.outer(speeds, speeds)
    return ClassFix(found.offsets / speeds, covariance, True, found.contrast, found.evidence)


def _speed(motion: Floats, lever: Floats) -> float:
    """Root mean square way of points (N, 3) about the origin for a unit of `motion` (6,)."""
    turn, shift = motion[:3], motion[3:]
    moments = lever.T @ lever / len(lever)
    square = turn @ (np.trace(moments) * np.eye(3) - moments) @ turn
    square += 2 * shift @ np.cross(turn, np.einsum("ij->j", lever) / len(lever)) + shift @ shift
    return float(np.sqrt(max(square, 1e-18)))


def _nothing(count: int, reason: str, contrast: float = 0.0, evidence: float = 0.0) -> ClassFix:
    return ClassFix(np.full(count, np.nan), np.diag(np.full(count, np.inf)), False, contrast, evidence, reason)


def _checked(points: np.ndarray, prob: np.ndarray, name: str) -> tuple[Floats, Floats]:
    points, prob = np.ascontiguousarray(points, float), np.ascontiguousarray(prob, float)
    if points.ndim != 2 or points.shape[1] != 3 or prob.ndim != 2 or len(prob) != len(points):
        raise InputError(
            "points and class probabilities do not fit",
            key=name,
            value=(points.shape, prob.shape),
            valid="(N, 3), (N, K)",
        )
    if np.isfinite(points).all() and np.isfinite(prob).all():
        return points, prob
    finite = np.isfinite(points).all(axis=1) & np.isfinite(prob).all(axis=1)
    return points[finite], prob[finite]
