"""How one scan lies to another: poses from nothing, or from a guess that is too far off for a registration."""

from dataclasses import dataclass, field

import numpy as np
from numba import njit
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform, RotationMatrix

from ...config import check_config, quantity
from .birds_eye import correlate_views
from .refinement import class_evidence, judge, refine
from .view import View, ViewConfig

# Points of each view by which peaks are judged before they are refined.
PREVIEW = 200


@dataclass(kw_only=True)
class PoseSearchConfig:
    """How the pose of one scan in another is searched, and how a pose is scored."""

    view: ViewConfig = field(default_factory=ViewConfig)
    # [m] Pixel of the images from above.
    pixel: float = quantity(0.25, unit="m", above=0)
    # [m] Columns nearer to the sensors than this are in the images.
    image_range: float = quantity(15.0, unit="m", above=0)
    # [deg] Step of the yaws that are tried; half of it moves a wall at 10 m by a pixel and a half.
    yaw_step_deg: float = quantity(4.0, unit="deg", above=0, high=30)
    # [m] Largest distance between the two sensors.
    max_distance: float = quantity(20.0, unit="m", above=0)
    # [-] What an occupied pixel on the other's free floor costs against one on occupied.
    image_penalty: float = quantity(0.3, unit="-", low=0)
    # Peaks of the correlation that are judged; and refined, the best of them.
    peaks: int = quantity(500, unit="peaks", low=1)
    refined: int = quantity(40, unit="peaks", low=1)
    # [m] Distance of partners, stage by stage, and Gauss-Newton steps of each at most.
    max_distances: list[float] = quantity([0.8, 0.4, 0.15], unit="m", above=0)
    max_iterations: int = quantity(8, unit="iterations", low=1)
    # [m] A point this near to a surface of the other view agrees with it.
    agree_distance: float = quantity(0.25, unit="m", above=0)
    # [m] A point this much nearer than what the other view saw in its direction is where that saw only air.
    clear_margin: float = quantity(0.4, unit="m", above=0)
    # [-] What a denied point costs against one that agrees: of a pose that is refined, and of one that is not yet.
    penalty: float = quantity(12.0, unit="-", low=0)
    rough_penalty: float = quantity(5.0, unit="-", low=0)
    # [1/nat] What the classes' evidence counts in the score, where there are any, and how much of it at most [nat].
    class_weight: float = quantity(0.05, unit="1/nat", low=0)
    class_limit: float = quantity(5.0, unit="nat", low=0)
    # [columns] How many neighbours have the errors of their labels in common.
    columns_per_sample: float = quantity(20.0, unit="columns", above=0)
    # [m], [deg] Poses nearer to each other than this are one.
    same_distance: float = quantity(0.5, unit="m", above=0)
    same_angle_deg: float = quantity(6.0, unit="deg", above=0)
    # [-] A second pose with a score this near to the first makes the answer ambiguous, and a first below it a guess.
    clear_lead: float = quantity(0.05, unit="-", low=0)
    min_score: float = quantity(0.05, unit="-")
    # Candidates that are returned at most.
    candidates: int = quantity(5, unit="poses", low=1)


@dataclass(kw_only=True)
class NearSearchConfig(PoseSearchConfig):
    """`PoseSearchConfig` around a guess."""

    # [m], [deg] How far the guess may be off.
    span: float = quantity(1.5, unit="m", above=0)
    span_yaw_deg: float = quantity(30.0, unit="deg", above=0, high=180)


@dataclass(frozen=True, eq=False)
class PoseCandidate:
    """A pose that one scan may have in another.

    Attributes:
        X_TS: pose of the source in the target.
        score: agreed − penalty · denied, plus the classes' part; at most 1 without classes.
        agreed: share of the points of walls and objects that lie on what the other scan saw, mean of both directions.
        denied: share that lie where the other saw only air, mean of both directions.
        class_evidence: log likelihood ratio of the classes of what lies on each other, for the same place against
            unrelated ones [nat]; 0 without classes.
        ambiguous: another pose explains the scans about as well, or this one hardly does; of all candidates the same.
    """

    X_TS: RigidTransform
    score: float
    agreed: float
    denied: float
    class_evidence: float
    ambiguous: bool

    def __deepcopy__(self, memo: dict) -> "PoseCandidate":
        return self


def find_pose(
    source: PointCloud | View, target: PointCloud | View, config: PoseSearchConfig | None = None
) -> tuple[PoseCandidate, ...]:
    """Poses X_TS that may lay `source` on `target`, distinct and best first; empty when either cannot be searched.

    Nothing is known about yaw and position; roll and pitch are taken from the floor, or from the up that a `View` was
    given. Position is right to centimetres in simulated rooms and to 0.25 m in recordings; height, roll and pitch as
    far as the floor is known: `register` goes on from there.

    1. Both scans are seen from above, and their images correlated over all yaws and shifts, see `correlate_views`.
    2. The best peaks are refined in the plane, from line to line in both directions.
    3. A pose is scored by what both scans say about each other's points: one on a surface of the other agrees, one in
       what the other saw through is evidence against the pose. This tells a rectangular hall from itself turned by
       180°. Classes, where both clouds have `class_probabilities`, add their log likelihood ratio.
    """
    config = config or PoseSearchConfig()
    check_config(config)
    yaws = np.deg2rad(np.arange(0.0, 360.0, config.yaw_step_deg))
    a, b = _view(source, config), _view(target, config)
    if a.problem or b.problem:
        return ()
    return _search(a, b, config, yaws, np.zeros(2), config.max_distance, np.zeros((0, 3)))


def align_near(
    source: PointCloud | View,
    target: PointCloud | View,
    X_TS_guess: RigidTransform,
    config: NearSearchConfig | None = None,
) -> tuple[PoseCandidate, ...]:
    """As `find_pose`, within `span` and `span_yaw_deg` of a guess, which is one of the starts.

    For `register` to try again from when its guess led to a fit that is poor: with partial overlap, a guess that is
    half a metre and ten degrees off may lead local methods into a wrong basin. Fewer yaws make it quicker than
    `find_pose`; pass a `View` to make neither cloud ready twice. Take the first candidate as a new guess, unless it is
    `ambiguous`.
    """
    config = config or NearSearchConfig()
    check_config(config)
    a, b = _view(source, config), _view(target, config)
    if a.problem or b.problem or not np.isfinite(X_TS_guess.GetAsMatrix34()).all():
        return ()
    X = b.X_LS @ X_TS_guess @ a.X_LS.inverse()
    R, shift = X.rotation().matrix(), X.translation()[:2]
    yaw = float(np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1]))
    steps = int(config.span_yaw_deg / config.yaw_step_deg)
    yaws = yaw + np.deg2rad(config.yaw_step_deg) * np.arange(-steps, steps + 1)
    return _search(a, b, config, yaws, shift, config.span, np.array([[yaw, *shift]]))


def judge_pose(
    source: PointCloud | View, target: PointCloud | View, X_TS: RigidTransform, config: PoseSearchConfig | None = None
) -> PoseCandidate:
    """Scores a pose that came from elsewhere, as `find_pose` does with its own; `ambiguous` says only it is poor."""
    config = config or PoseSearchConfig()
    a, b = _view(source, config), _view(target, config)
    R = (b.X_LS @ X_TS @ a.X_LS.inverse()).rotation().matrix()
    x, y, _ = (b.X_LS @ X_TS @ a.X_LS.inverse()).translation()
    pose = np.array([[np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1]), x, y]])
    agreed, denied, evidence, score = (float(value[0]) for value in _scores(a, b, pose, config))
    return PoseCandidate(X_TS, score, agreed, denied, evidence, score < config.min_score)


def _view(cloud: PointCloud | View, config: PoseSearchConfig) -> View:
    return cloud if isinstance(cloud, View) else View(cloud, config.view)


def _search(
    source: View,
    target: View,
    config: PoseSearchConfig,
    yaws: np.ndarray,
    centre: np.ndarray,
    span: float,
    starts: np.ndarray,
) -> tuple[PoseCandidate, ...]:
    peaks = correlate_views(
        source, target, yaws, centre, span, config.image_range, config.pixel, config.image_penalty, 4 * config.peaks
    )
    # Two starts for one peak cost a refinement each and end at one pose.
    near = config.same_distance, float(np.deg2rad(config.same_angle_deg))
    poses = np.ascontiguousarray(peaks[:, 1:])
    poses = np.vstack([starts, poses[_distinct(poses, *near, config.peaks)]])
    before = _scores(source, target, poses, config, PREVIEW)[3]
    # Half by each: long walls on each other are the highest peaks, but where little is shared it is what is not denied.
    promising = np.argsort(-before, kind="stable")[: config.refined // 2]
    poses = poses[np.union1d(promising, np.arange(min(len(poses), config.refined - len(promising))))]
    a, b = source.columns, target.columns
    refined = refine(
        poses,
        *(a.centres, a.normals, a.flatness, b.centres, b.normals, b.flatness, *source.nearest, *target.nearest),
        source.config.cell / 2,
        source.p_LV is not None and target.p_LV is not None,
        np.array(config.max_distances, float),
        config.max_iterations,
    )
    refined = refined[np.hypot(refined[:, 1] - centre[0], refined[:, 2] - centre[1]) < 1.5 * span]
    if len(refined) == 0:
        return ()
    agreed, denied, evidence, score = _scores(source, target, refined, config)
    order = np.argsort(-score, kind="stable")
    order = order[_distinct(refined[order], *near, config.candidates)]
    lead = score[order[0]] - score[order[1]] if len(order) > 1 else np.inf
    ambiguous = bool(lead < config.clear_lead or score[order[0]] < config.min_score)
    X_LT = target.X_LS.inverse()
    return tuple(
        PoseCandidate(
            X_LT @ _in_space(refined[k]) @ source.X_LS,
            float(score[k]),
            float(agreed[k]),
            float(denied[k]),
            float(evidence[k]),
            ambiguous,
        )
        for k in order
    )


def _scores(
    source: View, target: View, poses: np.ndarray, config: PoseSearchConfig, points: int = 0
) -> tuple[np.ndarray, ...]:
    """Agreed, denied, class evidence and score of each pose (P, 3), by about that many points of each, 0 for all."""
    c, s = np.cos(poses[:, 0]), np.sin(poses[:, 0])
    back = np.column_stack([-poses[:, 0], -c * poses[:, 1] - s * poses[:, 2], s * poses[:, 1] - c * poses[:, 2]])
    said = (_said(target, source, poses, config, points) + _said(source, target, back, config, points)) / 2
    agreed, denied = said.T
    score = agreed - (config.rough_penalty if points else config.penalty) * denied
    evidence = _class_evidence(source, target, poses, config)
    limit = config.class_limit
    return agreed, denied, evidence, score + config.class_weight * np.clip(evidence, -limit, limit)


def _said(view: View, other: View, poses: np.ndarray, config: PoseSearchConfig, points: int) -> np.ndarray:
    """What `view` says about the points of `other` at these poses in it."""
    own, theirs = view.columns, other.columns
    stride = max(len(other.raised) // points, 1) if points else 1
    eye = np.zeros(3) if view.p_LV is None else view.p_LV
    return judge(
        np.ascontiguousarray(poses),
        *(
            np.ascontiguousarray(other.raised[::stride]),
            np.ascontiguousarray(other.raised_column[::stride]),
            theirs.normals,
            theirs.flatness,
        ),
        *(own.centres, own.normals, own.flatness, own.heights, *view.nearest),
        view.config.cell / 2,
        view.p_LV is not None and other.p_LV is not None,
        *(view.clear_range, eye, config.agree_distance, config.clear_margin),
    )


def _class_evidence(source: View, target: View, poses: np.ndarray, config: PoseSearchConfig) -> np.ndarray:
    parts = (source.columns, target.columns, target.nearest), (source.floor, target.floor, target.nearest_floor)
    kinds = {part.classes.shape[1] for row in parts for part in row[:2]}
    if len(kinds) > 1 or 0 in kinds:
        return np.zeros(len(poses))
    seen = np.vstack([part.classes for row in parts for part in row[:2]])
    shares = np.maximum(seen.mean(axis=0), 1e-3)
    total = np.zeros(len(poses))
    for a, b, table in parts:
        if len(a.centres) and len(b.centres):
            cell = source.config.cell / 2
            total += class_evidence(
                poses, a.centres, a.classes, b.centres, b.classes, shares, *table, cell, config.agree_distance
            )
    return total / config.columns_per_sample


def _in_space(pose: np.ndarray) -> RigidTransform:
    return RigidTransform(RotationMatrix.MakeZRotation(pose[0]), np.array([pose[1], pose[2], 0.0]))


@njit(cache=True)
def _distinct(poses: np.ndarray, distance: float, angle: float, count: int) -> np.ndarray:
    """Indices of the first `count` of poses (P, 3) that are not near to a chosen one before them."""
    kept = np.zeros(count, np.int64)
    found = 0
    for k in range(len(poses)):
        apart = True
        for m in range(found):
            other = poses[kept[m]]
            turn = (poses[k, 0] - other[0] + np.pi) % (2 * np.pi) - np.pi
            dx, dy = poses[k, 1] - other[1], poses[k, 2] - other[2]
            if abs(turn) < angle and dx * dx + dy * dy < distance * distance:
                apart = False
                break
        if apart:
            kept[found] = k
            found += 1
            if found == count:
                break
    return kept[:found]
