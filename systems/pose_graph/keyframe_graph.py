"""The pose graph of a running survey: keyframes, what is between them, and loops; one function from state to state."""

from dataclasses import dataclass, field, replace

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from ..config import quantity
from ..slam.keyframe import Keyframe, KeyframePoses
from ..slam.motion import distance_and_angle
from ..slam.odometry_accuracy import OdometryAccuracy, odometry_covariance
from .consistency import position_deviations
from .graph import ATTITUDE, LOOP, ODOMETRY, REGISTRATION, PoseGraph, chi_squared
from .loop_detection import (
    LoopCheck,
    LoopDetectionConfig,
    Place,
    PlaceRecognition,
    check_loop,
    find_candidates,
    reach_of,
)
from .optimize import optimize
from .robust_loops import ACCEPTED, RobustLoopsConfig, decide_loops


@dataclass(kw_only=True)
class PoseGraphConfig:
    """How far each source of poses is trusted, when loops are looked for, and when poses are given out anew."""

    # [s] Interval at which a new keyframe is looked for; that of the scan matcher or shorter.
    period: float = quantity(0.1, unit="s", above=0)
    # [m], [deg] Standard deviations that are added to what a registration says of itself: points of neighbouring scans
    # share their errors, which no registration knows.
    registration_deviation: float = quantity(0.01, unit="m", above=0)
    registration_deviation_deg: float = quantity(0.1, unit="deg", above=0)
    # [m], [deg] Those of a keyframe that was placed by dead reckoning, and that nothing else is said of.
    blind_deviation: float = quantity(0.5, unit="m", above=0)
    blind_deviation_deg: float = quantity(5.0, unit="deg", above=0)
    # Whether odometry is an edge of its own beside the registration.
    use_odometry: bool = True
    odometry: OdometryAccuracy = field(default_factory=OdometryAccuracy)
    # [deg] Standard deviation of roll and pitch of X_OB against gravity, as edges of their own; 0: there are none.
    attitude_deviation_deg: float = quantity(0.0, unit="deg", low=0)
    # [keyframes] Without a new loop the graph is optimised after so many.
    optimize_every: int = quantity(20, unit="keyframes", low=1)
    # [m], [deg] Poses are given out anew when one of them has moved by more.
    tolerance: float = quantity(0.02, unit="m", low=0)
    tolerance_deg: float = quantity(0.2, unit="deg", low=0)
    loops: LoopDetectionConfig = field(default_factory=LoopDetectionConfig)
    # False loops are upright, too, and from rooms that look alike: a single loop has to be surer than in general.
    robust: RobustLoopsConfig = field(default_factory=lambda: RobustLoopsConfig(max_chance=1e-3, false_reach=10.0))


@dataclass(frozen=True, eq=False)
class Loop:
    """A place where the robot may have been before.

    Attributes:
        first, second: `Keyframe.index` of the earlier and of the later one.
        X_ij: pose of the later in the earlier.
        check: what its registration says.
        accepted: whether it is in the graph now.
        reason: why not, or `ACCEPTED`.
    """

    first: int
    second: int
    X_ij: RigidTransform
    check: LoopCheck
    accepted: bool
    reason: str

    def __deepcopy__(self, memo: dict) -> "Loop":
        return self


@dataclass(frozen=True, eq=False)
class KeyframeGraph:
    """Abstract state; read-only, so that Drake may share it instead of copying it at every update.

    Attributes:
        keyframes: as they came, in the order of their index.
        places: what loop detection knows of each; at the poses of the last optimisation.
        graph: poses of all keyframes, and all edges, the refused loops too.
        accepted: which edges count, (E,) bool.
        loops: those that a registration let pass, in the order of `graph.loops`, and after them those that it did not.
        published: what was last given out.
        since_optimum: keyframes since the last optimisation.
    """

    keyframes: tuple[Keyframe, ...] = ()
    places: tuple[Place, ...] = ()
    graph: PoseGraph | None = None
    accepted: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))
    loops: tuple[Loop, ...] = ()
    refused: tuple[Loop, ...] = ()
    published: KeyframePoses = field(default_factory=KeyframePoses)
    since_optimum: int = 0

    def __deepcopy__(self, memo: dict) -> "KeyframeGraph":
        return self


def add_keyframe(
    known: KeyframeGraph, keyframe: Keyframe, config: PoseGraphConfig, recognition: PlaceRecognition | None = None
) -> KeyframeGraph:
    """Takes in a keyframe: edges to the one before, loops to earlier ones, and new poses where these ask for it.

    A later version of the newest keyframe takes its place; older ones are ignored.
    """
    newest = known.keyframes[-1].index if known.keyframes else -1
    if keyframe.index < 0 or keyframe.index < newest:
        return known
    if keyframe.index == newest:
        place = replace(known.places[-1], cloud_B=keyframe.cloud_B)
        return replace(known, keyframes=(*known.keyframes[:-1], keyframe), places=(*known.places[:-1], place))
    grown = _with_edges(known, keyframe, config, recognition)
    found = _find_loops(grown, config, recognition)
    new_loops = len(found.loops) > len(grown.loops)
    if new_loops:
        return _published(_decided(found, config), config)
    if found.since_optimum >= config.optimize_every:
        assert found.graph is not None
        optimum = optimize(found.graph, edges=found.accepted, starts=("poses",))
        return _published(_moved(found, optimum.poses), config)
    return _published(found, config)


def finish(known: KeyframeGraph, config: PoseGraphConfig) -> KeyframeGraph:
    """The optimum over all: every loop is judged anew, and the optimisation tries more than one start."""
    if known.graph is None or len(known.keyframes) < 2:
        return known
    decision = decide_loops(known.graph, config.robust)
    optimum = optimize(known.graph.with_poses(decision.poses), edges=decision.accepted)
    done = replace(_with_decision(known, decision.accepted, decision.reasons), since_optimum=0)
    return _published(_moved(done, optimum.poses), config)


def _with_edges(
    known: KeyframeGraph, keyframe: Keyframe, config: PoseGraphConfig, recognition: PlaceRecognition | None
) -> KeyframeGraph:
    descriptor = None if recognition is None else recognition.describe(keyframe.cloud_B)
    if known.graph is None:
        none = np.zeros(0)
        first = PoseGraph(keyframe.X_MB.GetAsMatrix4()[None], none, none, none, none, none)
        return KeyframeGraph((keyframe,), (Place(keyframe.cloud_B, keyframe.X_MB, 0.0, descriptor),), first)
    graph, before, k = known.graph, known.keyframes[-1], len(known.keyframes)
    step = keyframe.X_PB if keyframe.X_PB is not None else before.X_MB.inverse() @ keyframe.X_MB
    edges = [(k - 1, k, step, registration_covariance(keyframe, config), REGISTRATION)]
    if keyframe.X_OB is not None and before.X_OB is not None:
        odometry = before.X_OB.inverse() @ keyframe.X_OB
        if config.use_odometry:
            edges.append((k - 1, k, odometry, odometry_covariance(odometry, config.odometry), ODOMETRY))
        if config.attitude_deviation_deg > 0:
            X_MO = known.keyframes[0].X_MB @ (known.keyframes[0].X_OB or RigidTransform()).inverse()
            tilt = np.eye(6) * np.deg2rad(config.attitude_deviation_deg) ** 2
            edges.append((k, k, X_MO @ keyframe.X_OB, tilt, ATTITUDE))
    X_MB = (
        RigidTransform(RotationMatrix.ProjectToRotationMatrix(graph.poses[-1, :3, :3]), graph.poses[-1, :3, 3]) @ step
    )
    way = known.places[-1].way + float(np.linalg.norm(step.translation()))
    return replace(
        known,
        keyframes=(*known.keyframes, keyframe),
        places=(*known.places, Place(keyframe.cloud_B, X_MB, way, descriptor)),
        graph=_extended(graph, X_MB, edges),
        accepted=np.append(known.accepted, np.ones(len(edges), bool)),
        since_optimum=known.since_optimum + 1,
    )


def _extended(
    graph: PoseGraph,
    X_MB: RigidTransform | None,
    edges: list[tuple[int, int, RigidTransform, np.ndarray, int]],
) -> PoseGraph:
    """The graph with one more pose, where given, and more edges."""
    i, j, X_ij, covariance, kind = zip(*edges, strict=True)
    return PoseGraph(
        graph.poses if X_MB is None else np.concatenate([graph.poses, X_MB.GetAsMatrix4()[None]]),
        np.append(graph.i, i),
        np.append(graph.j, j),
        np.concatenate([graph.X_ij, [X.GetAsMatrix4() for X in X_ij]]),
        np.concatenate([graph.information, np.linalg.inv(np.array(covariance))]),
        np.append(graph.kind, kind),
    )


def registration_covariance(keyframe: Keyframe, config: PoseGraphConfig) -> np.ndarray:
    """Covariance of the step to a keyframe in its own axes, (6, 6): its registration's, with the floor of `config`."""
    if keyframe.health <= 0:
        return _diagonal(config.blind_deviation_deg, config.blind_deviation)
    floor = _diagonal(config.registration_deviation_deg, config.registration_deviation)
    if keyframe.covariance is None or not np.isfinite(keyframe.covariance).all():
        return floor
    R = np.kron(np.eye(2), keyframe.X_MB.rotation().matrix().T)
    return R @ keyframe.covariance @ R.T + floor


def _diagonal(degrees: float, metres: float) -> np.ndarray:
    return np.diag(np.repeat([np.deg2rad(degrees) ** 2, metres**2], 3))


def _find_loops(known: KeyframeGraph, config: PoseGraphConfig, recognition: PlaceRecognition | None) -> KeyframeGraph:
    if known.graph is None or len(known.places) < 2:
        return known
    deviation = position_deviations(known.graph, np.flatnonzero(known.accepted))
    k = len(known.places) - 1
    edges: list[tuple[int, int, RigidTransform, np.ndarray, int]] = []
    loops: list[Loop] = []
    refused: list[Loop] = []
    reach = reach_of(deviation, config.loops, recognition)
    for n in find_candidates(known.places, deviation, config.loops, recognition):
        check = check_loop(known.places, n, config.loops, recognition, float(reach[n]))
        first, second = known.keyframes[n].index, known.keyframes[k].index
        loop = Loop(first, second, check.X_TS, check, False, check.reason)
        if check.reason:
            refused.append(loop)
            continue
        floor = _diagonal(config.registration_deviation_deg, config.registration_deviation)
        edges.append((n, k, check.X_TS, check.covariance + floor, LOOP))
        loops.append(loop)
    refused_before, graph = known.refused, known.graph
    return replace(
        known,
        refused=(*refused_before, *refused),
        graph=_extended(graph, None, edges) if edges else graph,
        accepted=np.append(known.accepted, np.zeros(len(edges), bool)),
        loops=(*known.loops, *loops),
    )


def _decided(known: KeyframeGraph, config: PoseGraphConfig) -> KeyframeGraph:
    assert known.graph is not None
    decision = decide_loops(known.graph, config.robust, believed=known.accepted & (known.graph.kind == LOOP))
    return _moved(_with_decision(known, decision.accepted, decision.reasons), decision.poses)


def _with_decision(known: KeyframeGraph, accepted: np.ndarray, reasons: tuple[str, ...]) -> KeyframeGraph:
    loops = tuple(
        replace(loop, accepted=reason == ACCEPTED, reason=reason)
        for loop, reason in zip(known.loops, reasons, strict=True)
    )
    return replace(known, accepted=accepted, loops=loops)


def _moved(known: KeyframeGraph, poses: np.ndarray) -> KeyframeGraph:
    assert known.graph is not None
    places = tuple(
        replace(place, X_MB=RigidTransform(RotationMatrix.ProjectToRotationMatrix(X[:3, :3]), X[:3, 3]))
        for place, X in zip(known.places, poses, strict=True)
    )
    return replace(known, graph=known.graph.with_poses(poses), places=places, since_optimum=0)


def _published(known: KeyframeGraph, config: PoseGraphConfig) -> KeyframeGraph:
    """Gives out the poses of new keyframes, and all anew when one that was given out has moved."""
    old = known.published
    moved = False
    for keyframe, place in zip(known.keyframes, known.places, strict=True):
        if keyframe.index in old.poses:
            distance, angle = distance_and_angle(old.poses[keyframe.index].inverse() @ place.X_MB)
            moved |= distance > config.tolerance or angle > np.deg2rad(config.tolerance_deg)
    poses = {keyframe.index: place.X_MB for keyframe, place in zip(known.keyframes, known.places, strict=True)}
    if moved:
        return replace(known, published=KeyframePoses(old.version + 1, poses))
    return replace(known, published=KeyframePoses(old.version, poses | old.poses))


def misfit(known: KeyframeGraph) -> float:
    """ξᵀ Ω ξ a degree of freedom over the accepted edges; 1 when all covariances are right, 0 without loops to tell."""
    if known.graph is None:
        return 0.0
    freedom = 6 * (int(known.accepted.sum()) - len(known.graph.poses) + 1)
    return float(chi_squared(known.graph)[known.accepted].sum()) / freedom if freedom > 0 else 0.0
