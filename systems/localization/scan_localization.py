"""Where the robot is, from one scan to the next: prediction, evolution, refinement, fusion, and the map that grows."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from ..config import check_config
from .evolution_strategy import evolve, evolve_as_paper
from .grid_kernels import NOBODY, PLAN
from .laser_scan import LaserScan
from .likelihood_field import LikelihoodField, make_field
from .localizer_config import LocalizerConfig
from .match_kernels import find_patches, likelihood_fitness, refine
from .occupancy_grid import OccupancyGrid
from .planar import between, compose, difference, levered, transform
from .uncertainty import fuse, information_of, predict, surprise, the_lower

# Chi-square of 3 degrees of freedom that 1 of 1000 exceeds.
_SURPRISE = 16.27
# Covariances stay at or above these, so that they can be inverted [m², rad²].
_LEAST = np.diag([1e-8, 1e-8, 1e-9])

# That of a keyframe against the map that it has just become part of.
_JOINED = np.diag([1e-4, 1e-4, 1e-5])


@dataclass(frozen=True, eq=False)
class Localization:
    """What the localiser knows after a scan. Read-only.

    Attributes:
        pose: X_MB (3,) [m, m, rad] at `time` [s]; scans: how many were taken in.
        covariance: of `pose` in the axes of M, (3, 3). relative: against the map around, which may itself be off; the
            same when the map was given. health: fitness of the scan at the pose, in [0, 1].
        lost: the position may be off by more than is allowed, or the scan has not fitted for several scans.
        tracked: whether the last scan had enough beams on the map to say anything.
        surprise: of the last scan against prediction, chi-square of 3 degrees of freedom; above 16 odometry failed.
        information: what the last scan alone says of the pose, inverse covariance in the axes of M, (3, 3).
        grid, likelihood: the map, and the distance to its surfaces. X_OB: odometry at `time`.
        look: way and turn since the last independent look, as a share of one.
        poor: successive scans without health. keyframes: poses of the scans in the map, (K, 3), and their covariances.
    """

    pose: np.ndarray
    covariance: np.ndarray
    relative: np.ndarray
    grid: OccupancyGrid
    likelihood: LikelihoodField
    time: float = 0.0
    scans: int = 0
    health: float = 0.0
    lost: bool = False
    tracked: bool = False
    surprise: float = 0.0
    information: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    X_OB: np.ndarray | None = None
    look: float = 1.0
    poor: int = 0
    keyframes: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    keyframe_covariances: np.ndarray = field(default_factory=lambda: np.zeros((0, 3, 3)))

    def __deepcopy__(self, memo: dict) -> "Localization":
        return self


def start_localization(
    config: LocalizerConfig, grid: OccupancyGrid | None = None, pose: np.ndarray | None = None
) -> Localization:
    """What is known before the first scan, whose pose it is as long as no odometry says where it was.

    Args:
        grid: the map; an empty one when not given, which only helps where `config.mapping` is set.
        pose: X_MB (3,), zero when not given.

    Raises:
        ConfigError: a value of `config` is out of range.
    """
    check_config(config, key="localizer")
    grid = grid or OccupancyGrid.empty(config.occupancy)
    deviation = np.array([config.start_deviation, config.start_deviation, math.radians(config.start_deviation_deg)])
    start = np.zeros(3) if pose is None else np.array(pose, np.float64).reshape(3)
    # The first scan of a map that is made from nothing says where M is.
    covariance = np.diag(deviation**2) if grid.occupied.any() else _LEAST
    return Localization(start, covariance, covariance, grid, make_field(grid, config.reach))


def localize(
    known: Localization,
    scan: LaserScan,
    X_OB: np.ndarray,
    config: LocalizerConfig,
    *,
    X_BS: np.ndarray | None = None,
    seed: int = 0,
) -> Localization:
    """Takes in a scan.

    Args:
        X_OB: odometry at the time of the scan, (3,), from any origin.
        X_BS: pose of the laser on the robot, (3,).
        seed: of the evolution; the number of the scan counts its streams.
    """
    step, duration = motion_since(known, scan, X_OB)
    pose, covariance = predict(known.pose, known.covariance, step, config.odometry)
    _, relative = predict(known.pose, known.relative, step, config.odometry)
    moved = math.hypot(step[0], step[1]) / config.new_look + abs(step[2]) / math.radians(config.new_look_deg)
    ahead = replace(
        known, pose=pose, covariance=covariance + _LEAST, relative=relative + _LEAST, time=scan.time,
        scans=known.scans + 1, X_OB=X_OB, look=min(known.look + moved, 1.0),
    )  # fmt: skip
    points = usable_points(scan, config, X_BS, step, duration)
    if len(points) < config.min_beams:
        return _judged(replace(ahead, health=0.0, tracked=False, surprise=0.0, information=np.zeros((3, 3))), config)
    if len(known.keyframes) == 0 and config.mapping and not known.grid.occupied.any():
        return _with_keyframe(replace(ahead, health=1.0, tracked=True), points, X_BS, config)
    match = _paper_match if config.method == "paper" else _match
    after = _judged(match(ahead, _thinned(points, config.beams), config, seed), config)
    # Where nothing is in the map yet, it goes on by odometry; where the scan contradicts it, it does not.
    if config.mapping and (not after.tracked or after.poor < config.lost_scans) and _is_new(after, config):
        after = _with_keyframe(after, points, X_BS, config)
    return after


def motion_since(known: Localization, scan: LaserScan, X_OB: np.ndarray) -> tuple[np.ndarray, float]:
    """Motion X_BB' (3,) by odometry up to a scan, and how long it took [s]; none where odometry begins with it."""
    if known.X_OB is None:
        return np.zeros(3), 0.0
    return between(known.X_OB, X_OB), scan.time - known.time


def usable_points(
    scan: LaserScan, config: LocalizerConfig, X_BS: np.ndarray | None, step: np.ndarray, duration: float
) -> np.ndarray:
    """Ends of the beams within range, in B at the end of the scan, (n, 2) [m]; without what the motion did to them.

    Args:
        step: motion X_BB' since `duration` [s] before the end of the scan; none where that is not positive.
    """
    kept = np.flatnonzero(scan.ranges < min(config.max_range, scan.range_max))
    r, a = scan.ranges[kept], scan.angles[kept]
    points = np.stack([r * np.cos(a), r * np.sin(a)], axis=1)
    points = points if X_BS is None else transform(np.asarray(X_BS, np.float64), points)
    if duration > 0 and np.any(scan.ages[kept] > 0):
        back = -scan.ages[kept] / duration
        turn = back * step[2]
        c, s = np.cos(turn), np.sin(turn)
        # At constant twist the robot was at back · step, near enough for the part of a period.
        along = back[:, None] * step[:2]
        points = along + np.stack([c * points[:, 0] - s * points[:, 1], s * points[:, 0] + c * points[:, 1]], axis=1)
    return np.ascontiguousarray(points)


def _thinned(points: np.ndarray, most: int) -> np.ndarray:
    return points[np.linspace(0, len(points) - 1, most).astype(int)] if len(points) > most else points


def _match(ahead: Localization, points: np.ndarray, config: LocalizerConfig, seed: int) -> Localization:
    """Matches by evolution and refinement, and weighs the result against the prediction."""
    lf, prior = ahead.likelihood, ahead.pose
    cells = (lf.signed, lf.origin[0], lf.origin[1], lf.resolution, lf.reach / lf.resolution)
    spread = _spread(ahead.relative, config)
    # A weak prior: it keeps what the scan does not tell, and leaves the rest to the scan.
    weak = np.diag(1 / (4 * spread) ** 2)
    patch = find_patches(points, config.patch_length)
    best = evolve(lf, points, prior, spread, weak, float(patch[-1] + 1), config.evolution, seed=seed, index=ahead.scans)
    arguments = (config.beam_deviation, config.map_deviation, config.robust_deviation, 20)
    found, A, T, used = refine(*cells, points, patch, best, prior, weak, *arguments)
    if used < config.min_beams:
        return replace(ahead, health=0.0, tracked=False, surprise=0.0, information=np.zeros((3, 3)))
    raw = health = likelihood_fitness(*cells, points, found, config.evolution.fit_deviation)
    if config.mapping:
        health = min(raw * len(points) / used, 1.0)  # what is not in the map yet does not speak against the pose
    bent = config.mapped_normal_deviation_deg if config.mapping else config.normal_deviation_deg
    information = information_of(A, T, math.radians(bent))
    offset = difference(prior, found)
    odd = surprise(ahead.relative, information, offset)
    covariance, relative, look = ahead.covariance, ahead.relative, ahead.look
    if odd > _SURPRISE:
        at_prior = likelihood_fitness(*cells, points, prior, config.evolution.fit_deviation)
        if raw > at_prior + config.clearly_better:
            # Odometry was worse than it said: what it says now counts for less, and the scan in full.
            covariance, relative, look = covariance * (odd / 3), relative * (odd / 3), 1.0
        else:
            # Both poses fit: the map is poor here, and says more than it knows.
            information = information * (3 / odd)
    change, relative = fuse(relative, look * information, offset)
    if config.mapping:
        measured = np.linalg.inv(information + 1e-9 * np.eye(3)) + _map_covariance(ahead, points)
        covariance = the_lower(covariance, measured)
    else:
        covariance = relative
    pose = prior + change
    pose[2] = math.atan2(math.sin(pose[2]), math.cos(pose[2]))
    return replace(
        ahead, pose=pose, covariance=covariance, relative=relative, health=health, tracked=True, surprise=odd, look=0.0,
        information=information,
    )  # fmt: skip


def _paper_match(ahead: Localization, points: np.ndarray, config: LocalizerConfig, seed: int) -> Localization:
    """The pose of the evolution strategy as it is; as covariance the spread of its last population."""
    spread = _spread(ahead.relative, config)
    pose, health, covariance = evolve_as_paper(
        ahead.grid, points, ahead.pose, spread, config.evolution, seed=seed, index=ahead.scans
    )
    return replace(
        ahead,
        pose=pose,
        covariance=covariance + _LEAST,
        relative=covariance + _LEAST,
        health=health,
        tracked=True,
        surprise=0.0,
    )


def _spread(covariance: np.ndarray, config: LocalizerConfig) -> np.ndarray:
    """Deviation of the first generation, (3,) [m, m, rad]."""
    least = np.array([config.least_spread, config.least_spread, math.radians(config.least_spread_deg)])
    most = np.array([config.most_spread, config.most_spread, math.radians(config.most_spread_deg)])
    return np.clip(np.sqrt(np.diag(covariance)), least, most)


def _map_covariance(known: Localization, points: np.ndarray) -> np.ndarray:
    """Covariance of the map where the scan lies on it, as that of a pose here, (3, 3): the mean over its beams.

    A pose in a map inherits the error of the keyframe that entered what is seen: a turn of that one moves all of it.
    """
    lf, result = known.likelihood, np.zeros((3, 3))
    ij = np.floor((transform(known.pose, points) - lf.origin) / lf.resolution).astype(int)
    inside = ((ij >= 0) & (ij < lf.owner.shape)).all(axis=1)
    owners, counts = np.unique(lf.owner[tuple(ij[inside].T)], return_counts=True)
    seen = owners != NOBODY
    for owner, count in zip(owners[seen], counts[seen], strict=True):
        if owner != PLAN:  # a plan is right
            dx, dy = known.pose[:2] - known.keyframes[owner, :2]
            result += count / counts[seen].sum() * levered(known.keyframe_covariances[owner], dx, dy)
    return result


def _judged(known: Localization, config: LocalizerConfig) -> Localization:
    poor = known.poor + 1 if known.health < config.min_health else 0
    deviation = math.sqrt(np.linalg.eigvalsh(known.covariance[:2, :2])[1])
    return replace(known, poor=poor, lost=poor >= config.lost_scans or deviation > config.lost_deviation)


def _is_new(known: Localization, config: LocalizerConfig) -> bool:
    """Whether the robot has moved far enough from the last keyframe."""
    if len(known.keyframes) == 0:
        return True
    step = between(known.keyframes[-1], known.pose)
    far = math.hypot(step[0], step[1]) > config.keyframe_distance
    return far or abs(step[2]) > math.radians(config.keyframe_angle_deg)


def _with_keyframe(
    known: Localization, points: np.ndarray, X_BS: np.ndarray | None, config: LocalizerConfig
) -> Localization:
    """Enters a scan into the map, and makes its field anew where it changed; the paper's strategy has no use for it."""
    X_BS = np.zeros(3) if X_BS is None else np.asarray(X_BS, np.float64)
    X_MS = compose(known.pose, X_BS)
    p_SP = transform(between(X_BS, np.zeros(3)), points)
    grid = known.grid.with_scan(p_SP, X_MS, config.occupancy, number=len(known.keyframes))
    likelihood = known.likelihood
    if config.method != "paper":
        p_MP = transform(X_MS, p_SP)
        low, high = np.minimum(p_MP.min(axis=0), X_MS[:2]), np.maximum(p_MP.max(axis=0), X_MS[:2])
        likelihood = make_field(grid, config.reach, before=likelihood, changed=(low, high))
    return replace(
        known,
        relative=_JOINED,
        grid=grid,
        likelihood=likelihood,
        keyframes=np.concatenate([known.keyframes, known.pose[None]]),
        keyframe_covariances=np.concatenate([known.keyframe_covariances, known.covariance[None]]),
    )
