"""Has the robot been here before? Candidates, and what a registration and the classes say of them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform
from scipy.spatial import cKDTree

from ..clouds import VoxelCloud, transform_points
from ..config import quantity
from ..registration import Registration, RegistrationConfig, register


def _loop_registration() -> RegistrationConfig:
    # What geometry and classes leave open is not to be taken from the guess as if it had been seen.
    return RegistrationConfig(free_deviation=100.0, retry_yaws_deg=[])


@dataclass(kw_only=True)
class LoopDetectionConfig:
    """Where loops are looked for, and what one must show."""

    # [m] Way that the robot has gone in between; less is no loop.
    min_way: float = quantity(10.0, unit="m", low=0)
    # [m] A keyframe is a candidate when it is this near, ...
    near: float = quantity(3.0, unit="m", above=0)
    # [-] ... or nearer than so many standard deviations of the pose between the two, ...
    deviations: float = quantity(3.0, unit="-", low=0)
    # [m] ... but not farther than this.
    far: float = quantity(10.0, unit="m", above=0)
    # [keyframes] Candidates are so many keyframes apart, ...
    spacing: int = quantity(5, unit="keyframes", low=1)
    # [candidates] ... and at most so many are registered for a new keyframe: that bounds the time of an update.
    max_candidates: int = quantity(2, unit="candidates", low=0)
    # [-] With a place descriptor: its largest distance. `PlaceRecognition` says what is usual.
    max_descriptor_distance: float = quantity(1.4, unit="-", above=0)
    # [keyframes] The sub-map around a candidate: the candidate and so many on either side.
    submap_keyframes: int = quantity(3, unit="keyframes", low=0)
    # [m] Grid of the sub-map.
    submap_voxel: float = quantity(0.15, unit="m", above=0)
    # [-] Smallest fitness of the registration, and smallest part of the scan that lies on the sub-map.
    min_fitness: float = quantity(0.6, unit="-", low=0, high=1)
    min_overlap: float = quantity(0.6, unit="-", low=0, high=1)
    # [m] A point this near to the sub-map lies on it.
    overlap_distance: float = quantity(0.3, unit="m", above=0)
    # [nat] Mean log-likelihood ratio of the classes of points that lie on each other, "the same place" against
    # "unrelated". It is below 0 on average for unrelated places, and about 0 where all is of one class.
    min_class_evidence: float = quantity(-0.02, unit="nat")
    registration: RegistrationConfig = field(default_factory=_loop_registration)


@dataclass(frozen=True)
class PlaceRecognition:
    """Functions that know a place again by its cloud alone, however far the estimated poses are off.

    Attributes:
        describe: descriptor of a keyframe's cloud, (D,).
        distance: of one descriptor (D,) to others (M, D), (M,).
        align: pose of a source cloud in a target cloud from nothing, or None where it finds none: the guess of the
            registration where that of the poses fails.
    """

    describe: Callable[[PointCloud], np.ndarray]
    distance: Callable[[np.ndarray, np.ndarray], np.ndarray]
    align: Callable[[PointCloud, PointCloud], RigidTransform | None] | None = None


@dataclass(frozen=True, eq=False)
class Place:
    """What loop detection knows of a keyframe.

    Attributes:
        cloud_B: its points in its own frame.
        X_MB: its pose in the map, as it is believed now.
        way: how far the robot had gone when it was taken [m].
        descriptor: of `PlaceRecognition`, (D,), or None.
    """

    cloud_B: PointCloud
    X_MB: RigidTransform
    way: float
    descriptor: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class LoopCheck:
    """What the registration of a candidate says.

    Attributes:
        X_TS: pose of the new keyframe in the candidate.
        covariance: (6, 6) of a small turn and shift about and along the new keyframe's axes [rad, m].
        fitness, overlap: parts of the scan, [0, 1].
        class_evidence: mean log-likelihood ratio a pair [nat]; 0 where a cloud has no classes.
        reason: why it is refused; "" when it is not.
    """

    X_TS: RigidTransform
    covariance: np.ndarray
    fitness: float
    overlap: float
    class_evidence: float
    reason: str


def find_candidates(
    places: Sequence[Place],
    deviation: np.ndarray,
    config: LoopDetectionConfig,
    recognition: PlaceRecognition | None = None,
) -> list[int]:
    """Indices of earlier places where the last one may be, the most likely first, at most `max_candidates`.

    A place is a candidate when it is as near as the uncertainty of the poses allows, see `reach_of`; with descriptors,
    those that look alike come first.

    Args:
        deviation: standard deviation of the position of the last place in each, (N,) [m].
    """
    here = places[-1]
    p_M = np.array([place.X_MB.translation() for place in places[:-1]]).reshape(-1, 3)
    distance = np.linalg.norm(p_M - here.X_MB.translation(), axis=1)
    elsewhere = here.way - np.array([place.way for place in places[:-1]]) >= config.min_way
    reach = reach_of(deviation[:-1], config, recognition)
    possible, cost = elsewhere & (distance <= reach), distance / (1 + distance)
    described = [n for n, place in enumerate(places[:-1]) if place.descriptor is not None]
    if recognition is not None and here.descriptor is not None and described:
        found = recognition.distance(here.descriptor, np.array([places[n].descriptor for n in described]))
        alike = np.full(len(cost), np.inf)
        alike[described] = found / config.max_descriptor_distance
        # What looks alike comes before what is only near.
        cost = np.where(alike <= 1, alike - 1, cost)
    chosen: list[int] = []
    for n in np.flatnonzero(possible)[np.argsort(cost[possible], kind="stable")]:
        if len(chosen) < config.max_candidates and all(abs(n - other) >= config.spacing for other in chosen):
            chosen.append(int(n))
    return chosen


def reach_of(
    deviation: np.ndarray, config: LoopDetectionConfig, recognition: PlaceRecognition | None = None
) -> np.ndarray:
    """How far from where it is thought to be a place may be, (N,) [m], with the standard deviations (N,) of that.

    Without a function that aligns clouds from nothing a registration would not find what is beyond `far`. What is
    beyond the deviations is no loop, however alike it looks: a corridor looks the same from both of its ends.
    """
    reach = np.maximum(config.near, config.deviations * deviation)
    return reach if recognition is not None and recognition.align is not None else np.minimum(reach, config.far)


def submap(places: Sequence[Place], centre: int, config: LoopDetectionConfig) -> PointCloud:
    """The clouds of the places around one, in its frame, thinned. The last place, the one to be found, is left out."""
    low, high = max(centre - config.submap_keyframes, 0), min(centre + config.submap_keyframes + 1, len(places) - 1)
    X_BM = places[centre].X_MB.inverse()
    voxels = VoxelCloud(config.submap_voxel)
    for place in places[low:high]:
        voxels = voxels.insert(place.cloud_B, (X_BM @ place.X_MB).GetAsMatrix4())
    return voxels.to_cloud()


def check_loop(
    places: Sequence[Place],
    candidate: int,
    config: LoopDetectionConfig,
    recognition: PlaceRecognition | None = None,
    reach: float = np.inf,
) -> LoopCheck:
    """Registers the last place to the sub-map around a candidate, and judges fit, overlap and classes.

    Args:
        reach: how far the last place may be from where the poses say it is [m], see `reach_of`.
    """
    source, target = places[-1].cloud_B, submap(places, candidate, config)
    guess = places[candidate].X_MB.inverse() @ places[-1].X_MB
    found = register(source, target, guess, config.registration)
    if recognition is not None and recognition.align is not None and not _fits(found, config):
        again = recognition.align(source, target)
        if again is not None:
            second = register(source, target, again, config.registration)
            found = max(found, second, key=lambda result: (result.valid, result.fitness))
    if not found.valid:
        return LoopCheck(found.X_TS, found.covariance, 0.0, 0.0, 0.0, found.reason)
    R_ST = np.kron(np.eye(2), found.X_TS.rotation().matrix().T)
    covariance = R_ST @ found.covariance @ R_ST.T
    overlap, evidence = agreement(source, target, found.X_TS, config.overlap_distance)
    reason, away = "", float(np.linalg.norm((guess.inverse() @ found.X_TS).translation()))
    if away > reach:
        reason = f"{away:.1f} m from where the poses say, may be {reach:.1f} m"
    elif not _fits(found, config):
        reason = f"fitness {found.fitness:.2f}, needs {config.min_fitness:g}"
    elif any(axis.fixed_by == "guess" for axis in found.axes):
        # A fit that can slide says nothing of whether this is the place.
        reason = found.reason
    elif overlap < config.min_overlap:
        reason = f"overlap {overlap:.2f}, needs {config.min_overlap:g}"
    elif evidence < config.min_class_evidence:
        reason = f"classes disagree: {evidence:.2f} nat a pair, needs {config.min_class_evidence:g}"
    return LoopCheck(found.X_TS, covariance, found.fitness, overlap, evidence, reason)


def _fits(result: Registration, config: LoopDetectionConfig) -> bool:
    return result.valid and result.fitness >= config.min_fitness


def agreement(source: PointCloud, target: PointCloud, X_TS: RigidTransform, distance: float) -> tuple[float, float]:
    """Part of the source that has a target point within `distance` [m], and what the classes of these pairs say.

    Class evidence is the mean of log Σ_k p_k q_k / π_k over the pairs, with class probabilities p and q and shares π in
    both clouds: the log-likelihood ratio of "one surface" against "two that have nothing to do with each other".
    """
    p_SP, p_TQ = source.point.positions.numpy().astype(float), target.point.positions.numpy().astype(float)
    known = np.isfinite(p_SP).all(axis=1)
    if not known.any() or len(p_TQ) == 0:
        return 0.0, 0.0
    # Roughly one point a cell, so that what is near the sensor does not count for more.
    cell = np.floor(p_SP[known] / distance).astype(np.int64)
    chosen = np.flatnonzero(known)[np.unique(cell, axis=0, return_index=True)[1]]
    found, partner = cKDTree(p_TQ).query(
        transform_points(X_TS.GetAsMatrix4(), p_SP[chosen]), distance_upper_bound=distance
    )
    paired = np.isfinite(found)
    overlap = float(paired.mean())
    if not paired.any() or any("class_probabilities" not in cloud.point for cloud in (source, target)):
        return overlap, 0.0
    prob_S, prob_T = (cloud.point["class_probabilities"].numpy().astype(float) for cloud in (source, target))
    p, q = prob_S[chosen[paired]], prob_T[partner[paired]]
    labelled = np.isfinite(p).all(axis=1) & np.isfinite(q).all(axis=1)
    if not labelled.any():
        return overlap, 0.0
    shares = 0.5 * (np.nanmean(prob_S, axis=0) + np.nanmean(prob_T, axis=0))
    ratio = (p[labelled] * q[labelled] / np.maximum(shares, 1e-6)).sum(axis=1)
    return overlap, float(np.log(np.maximum(ratio, 1e-6)).mean())
