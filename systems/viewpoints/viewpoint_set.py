"""Several views of one place, far apart and without odometry: which belong together, and how they lie."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform, RollPitchYaw

from ..clouds import transform_points
from ..config import check_config, quantity
from ..errors import ConfigError
from .joint_registration import JointRegistrationConfig, register_jointly
from .place_search import PlaceCandidate, PlaceSearchConfig, judge, same_pose, search_place
from .viewpoint import Viewpoint

Pair = tuple[int, int]


@dataclass(kw_only=True)
class MergeConfig:
    """How views are joined, and when a join is believed."""

    search: PlaceSearchConfig = field(default_factory=PlaceSearchConfig)
    refinement: JointRegistrationConfig = field(default_factory=JointRegistrationConfig)
    # [-] Least score, summed over the views that are joined already. In 40 simulated stair halls, all but a few of the
    # best poses of a pair have 0.22 and more, and the next best 0.16 at most.
    min_score: float = quantity(0.15, unit="-", above=0, high=1)
    # [-] Least lead of the score over that of the next best pose; with less, the view could lie either way.
    min_lead: float = quantity(0.1, unit="-", above=0, high=1)
    # [-] Largest part of the walls and objects of two joined views that may lie where the other saw only air.
    max_denied: float = quantity(0.05, unit="-", above=0, high=1)


@dataclass(frozen=True)
class PairReport:
    """What the search found for one pair of views.

    Attributes:
        target, source: indices of the views.
        score, fitness, rmse: of the best candidate, see `PlaceCandidate`; -inf, 0 and inf without one.
        runner_up: score of the next best pose, -inf without one.
        used: whether the result agrees with the best candidate.
    """

    target: int
    source: int
    score: float
    runner_up: float
    fitness: float
    rmse: float
    used: bool


@dataclass(frozen=True, eq=False)
class MergeResult:
    """Views in one map. Read-only.

    Attributes:
        poses: X_MS of every joined view by index, S being the frame that it was given in. M is the levelled frame of
            the joined view with the lowest index, z up.
        covariances: (6, 6), see `JointRegistration`.
        left_out: why, for every other view.
        pairs: what was found for every pair.
        rmse: weighted root mean square distance between the joined surfaces [m]; inf with fewer than two views.
    """

    poses: dict[int, RigidTransform]
    covariances: dict[int, np.ndarray]
    left_out: dict[int, str]
    pairs: tuple[PairReport, ...]
    rmse: float

    def __deepcopy__(self, memo: dict) -> "MergeResult":
        return self


NOTHING_MERGED = MergeResult({}, {}, {}, (), float("inf"))


@dataclass(frozen=True, eq=False)
class ViewpointSet:
    """Views, the candidates of all their pairs, and the result. Read-only: `add` returns a new one.

    Attributes:
        clouds: as they were given, by index. X_VS: their levelling.
    """

    config: MergeConfig
    clouds: dict[int, PointCloud] = field(default_factory=dict)
    X_VS: dict[int, RigidTransform] = field(default_factory=dict)
    views: dict[int, Viewpoint] = field(default_factory=dict)
    candidates: dict[Pair, tuple[PlaceCandidate, ...]] = field(default_factory=dict)
    result: MergeResult = NOTHING_MERGED

    def __deepcopy__(self, memo: dict) -> "ViewpointSet":
        return self

    def add(
        self,
        index: int,
        cloud: PointCloud,
        rpy: np.ndarray | None = None,
        p_SR: np.ndarray | None = None,
    ) -> "ViewpointSet":
        """Returns this with one more view, searched against the others; the result stays until `solve`.

        Args:
            cloud: points in S, with any attributes.
            rpy: roll, pitch and yaw of S [rad], of which the first two are taken out; None for a level view.
            p_SR: where the sensor was, in S; the origin when not given.
        """
        X_VS = RigidTransform() if rpy is None else RigidTransform(RollPitchYaw(rpy[0], rpy[1], 0.0), np.zeros(3))
        view = Viewpoint(_levelled(cloud, X_VS), self.config.search.view, None if p_SR is None else X_VS @ p_SR)
        found = {(other, index): search_place(view, self.views[other], self.config.search) for other in self.views}
        grown = replace(
            self,
            clouds={**self.clouds, index: cloud},
            X_VS={**self.X_VS, index: X_VS},
            views={**self.views, index: view},
            candidates={**self.candidates, **found},
        )
        return grown

    def solve(self) -> "ViewpointSet":
        """Returns this with the result of all views that were added."""
        return replace(self, result=_solve(self))


def merge_viewpoints(
    clouds: Sequence[PointCloud], config: MergeConfig | None = None, rpy: Sequence[np.ndarray] | None = None
) -> MergeResult:
    """Joins views of one place that were taken metres apart, in any order, without odometry or guess.

    S0-d joins five viewpoints by ICP from guesses picked by hand. Here every pair is searched (`search_place`); the
    most certain pair is the start, and the view that fits best to all that are joined so far is added until none fits;
    of all starts, the largest set counts. Then all poses are refined at once (`register_jointly`). A view that fits
    nowhere, in two ways, or against what another one saw stays out, with the reason.

    Args:
        clouds: points in the frame S of each view, seen from its origin.
        rpy: roll, pitch and yaw of each [rad], of which the first two are taken out; level when not given.

    Raises:
        ConfigError: a value of the configuration is out of range.
    """
    config = config or MergeConfig()
    check_config(config, where="merge_viewpoints")
    check_lists(config)
    views = ViewpointSet(config)
    for index, cloud in enumerate(clouds):
        views = views.add(index, cloud, None if rpy is None else rpy[index])
    return views.solve().result


def check_lists(config: MergeConfig) -> None:
    """Raises `ConfigError` for a list with the wrong number of entries, which no range can say."""
    low_high = config.search.view.heights
    if len(low_high) != 2 or low_high[0] >= low_high[1]:
        raise ConfigError("wrong", key="search.view.heights", value=low_high, valid="lower and upper height [m]")
    for key, stages in (("search.refinement", config.search.refinement), ("refinement", config.refinement)):
        if not stages.max_distances:
            raise ConfigError("must not be empty", key=f"{key}.max_distances")


def _solve(views: ViewpointSet) -> MergeResult:
    config = views.config
    usable = [index for index, view in views.views.items() if not view.problem]
    left_out = {index: view.problem for index, view in views.views.items() if view.problem}
    best: dict[int, RigidTransform] = {usable[0]: RigidTransform()} if usable else {}
    best_score = 0.0
    reasons: dict[int, str] = {}
    starts = sorted((pair for pair in views.candidates if _is_certain(views, pair)), key=lambda p: -_score(views, p))
    tried: list[set[int]] = []
    for pair in starts:
        if any(set(pair) <= members for members in tried):
            continue
        poses, score, why = _grow(views, pair, usable)
        tried.append(set(poses))
        if (len(poses), score) > (len(best), best_score):
            best, best_score, reasons = poses, score, why
    if not starts:
        reasons = {index: _reason_without_start(views, index) for index in usable if index not in best}
    best = {index: best[index] for index in sorted(best)}
    covariances = {index: np.zeros((6, 6)) for index in best}
    rmse = float("inf")
    if len(best) > 1:
        first = next(iter(best.values())).inverse()
        poses = {index: first @ X for index, X in best.items()}
        edges = [(i, j) for i, j in combinations(poses, 2) if _judged(views, poses, i, j).agreed > 0.05]
        joined = register_jointly(views.views, poses, edges, config.refinement)
        best, covariances, rmse = joined.poses, joined.covariances, joined.rmse
    pairs = tuple(_report(views, pair, best) for pair in views.candidates)
    poses = {index: X_MV @ views.X_VS[index] for index, X_MV in best.items()}
    return MergeResult(poses, covariances, {**left_out, **reasons}, pairs, rmse)


def _grow(
    views: ViewpointSet, start: Pair, usable: list[int]
) -> tuple[dict[int, RigidTransform], float, dict[int, str]]:
    """Adds view after view to a pair. Returns the poses, the sum of scores, and why the others stay out."""
    config = views.config
    poses = {start[0]: RigidTransform(), start[1]: views.candidates[start][0].X_TS}
    total = _score(views, start)
    while True:
        best, reasons = (0.0, -1, RigidTransform()), {}
        for index in usable:
            if index in poses:
                continue
            placed = _placements(views, poses, index)
            score, denied, X = placed[0] if placed else (0.0, 0.0, RigidTransform())
            if score < config.min_score:
                reasons[index] = f"fits nowhere: score {score:.2f}, needs {config.min_score:g}"
            elif denied > config.max_denied:
                reasons[index] = f"contradicts a joined view: {denied:.0%} of it lies where only air was seen"
            elif len(placed) > 1 and score - placed[1][0] < config.min_lead:
                reasons[index] = f"ambiguous: fits in two ways, scores {score:.2f} and {placed[1][0]:.2f}"
            elif score > best[0]:
                best = (score, index, X)
        if best[1] < 0:
            return poses, total, reasons
        poses[best[1]] = best[2]
        total += best[0]


def _placements(
    views: ViewpointSet, poses: Mapping[int, RigidTransform], index: int
) -> list[tuple[float, float, RigidTransform]]:
    """Distinct poses of a view that a pair proposes, best first: sum of scores, worst denied share, pose."""
    proposals: list[RigidTransform] = []
    for other, X_MO in poses.items():
        for candidate in views.candidates.get((other, index), ()):
            proposals.append(X_MO @ candidate.X_TS)
        for candidate in views.candidates.get((index, other), ()):
            proposals.append(X_MO @ candidate.X_TS.inverse())
    placed = []
    for X in proposals:
        judged = [_judged(views, {**poses, index: X}, other, index) for other in poses]
        placed.append((sum(j.score for j in judged), max(j.denied for j in judged), X))
    placed.sort(key=lambda item: -item[0])
    distinct: list[tuple[float, float, RigidTransform]] = []
    for item in placed:
        if not any(same_pose(item[2], other[2], views.config.search, factor=2.0) for other in distinct):
            distinct.append(item)
    return distinct


def _judged(views: ViewpointSet, poses: Mapping[int, RigidTransform], i: int, j: int) -> PlaceCandidate:
    return judge(views.views[j], views.views[i], poses[i].inverse() @ poses[j], views.config.search)


def _score(views: ViewpointSet, pair: Pair, rank: int = 0) -> float:
    found = views.candidates[pair]
    return found[rank].score if len(found) > rank else float("-inf")


def _is_certain(views: ViewpointSet, pair: Pair) -> bool:
    config = views.config
    score = _score(views, pair)
    return (
        score >= config.min_score
        and score - _score(views, pair, 1) >= config.min_lead
        and views.candidates[pair][0].denied <= config.max_denied
    )


def _reason_without_start(views: ViewpointSet, index: int) -> str:
    pairs = [pair for pair in views.candidates if index in pair]
    best = max(pairs, key=lambda pair: _score(views, pair))
    score, needed = _score(views, best), views.config.min_score
    if score < needed:
        return f"fits no other view: score {score:.2f}, needs {needed:g}"
    return f"ambiguous: fits in two ways, scores {score:.2f} and {_score(views, best, 1):.2f}"


def _report(views: ViewpointSet, pair: Pair, poses: Mapping[int, RigidTransform]) -> PairReport:
    found = views.candidates[pair]
    if not found:
        return PairReport(*pair, float("-inf"), float("-inf"), 0.0, float("inf"), False)
    used = all(index in poses for index in pair)
    used = used and same_pose(poses[pair[0]].inverse() @ poses[pair[1]], found[0].X_TS, views.config.search)
    return PairReport(*pair, found[0].score, _score(views, pair, 1), found[0].fitness, found[0].rmse, used)


def _levelled(cloud: PointCloud, X_VS: RigidTransform) -> PointCloud:
    if "positions" not in cloud.point:
        return cloud
    points = transform_points(X_VS.GetAsMatrix4(), cloud.point.positions.numpy().astype(float))
    return PointCloud(np.ascontiguousarray(points, np.float32))
