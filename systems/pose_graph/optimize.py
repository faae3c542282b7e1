"""The poses that fit the edges best, with gtsam."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from .chordal import planar_chordal
from .graph import ATTITUDE, PLANAR, PoseGraph, PoseGraphError, chi_squared, dead_reckoning
from .rigid import adjoint, inverse

STARTS = ("poses", "odometry", "chordal")
# The first pose is held where it is: its deviation [rad, m].
_FIXED = 1e-4
# A step of the optimiser that lowers the sum of squares by a smaller part ends it.
_TOLERANCE = 1e-7
_MAX_ITERATIONS = 100


@dataclass(frozen=True, eq=False)
class Optimum:
    """What `optimize` found.

    Attributes:
        poses: X_WK, (N, 4, 4); the first one is that of the graph.
        chi_squared: of every edge of the graph, also of those that were left out, (E,).
        start: which of `STARTS` it came from.
        iterations: of the optimiser.
    """

    poses: np.ndarray
    chi_squared: np.ndarray
    start: str
    iterations: int


class Factors:
    """The edges of a graph as gtsam factors, made once, for any number of optimisations with some of them."""

    def __init__(self, graph: PoseGraph):
        self._graph = graph
        self._yaw = np.arctan2(graph.X_ij[:, 1, 0], graph.X_ij[:, 0, 0])
        make = self._planar if graph.planar else self._spatial
        self.factors = [make(e) for e in range(len(graph.i))]

    def _planar(self, e: int) -> gtsam.NonlinearFactor:
        X, order = self._graph.X_ij[e], [3, 4, 2]
        noise = gtsam.noiseModel.Gaussian.Information(self._graph.information[e][np.ix_(order, order)])
        measured = gtsam.Pose2(X[0, 3], X[1, 3], self._yaw[e])
        return gtsam.BetweenFactorPose2(int(self._graph.i[e]), int(self._graph.j[e]), measured, noise)

    def _spatial(self, e: int) -> gtsam.NonlinearFactor:
        i, X, information = int(self._graph.i[e]), self._graph.X_ij[e], self._graph.information[e]
        if self._graph.kind[e] == ATTITUDE:
            up_K = gtsam.Unit3(X[2, :3])
            # Its two rows are about axes that gtsam chooses: one deviation for both.
            sigma = float(np.sqrt(2 / np.trace(information[:2, :2])))
            isotropic = gtsam.noiseModel.Isotropic.Sigma(2, sigma)
            return gtsam.AttitudeFactorPose3(i, gtsam.Unit3(np.array([0.0, 0.0, 1.0])), isotropic, up_K)
        noise = gtsam.noiseModel.Gaussian.Information(information)
        return gtsam.BetweenFactorPose3(i, int(self._graph.j[e]), gtsam.Pose3(X), noise)

    def optimize(
        self, poses: np.ndarray, edges: np.ndarray | Sequence[int], max_iterations: int = _MAX_ITERATIONS
    ) -> tuple[np.ndarray, int]:
        """Levenberg-Marquardt with some of the edges, indices, from `poses` (N, 4, 4).

        Returns:
            The optimum (N, 4, 4) and the number of iterations.

        Raises:
            PoseGraphError: a pose hangs on no edge, or a number overflows.
        """
        factors = gtsam.NonlinearFactorGraph()
        for e in edges:
            factors.push_back(self.factors[e])
        factors.push_back(_hold_first(poses[0], self._graph.planar))
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setMaxIterations(max_iterations)
        parameters.setRelativeErrorTol(_TOLERANCE)
        parameters.setAbsoluteErrorTol(1e-9)
        try:
            optimizer = gtsam.LevenbergMarquardtOptimizer(factors, to_values(poses, self._graph.planar), parameters)
            values = optimizer.optimize()
        except RuntimeError as error:
            raise PoseGraphError(" ".join(str(error).split())[:200], where="gtsam") from None
        return from_values(values, self._graph.planar), int(optimizer.iterations())

    def marginals(self, poses: np.ndarray, edges: np.ndarray) -> Callable[[int, int], np.ndarray]:
        """A function (i, j) → covariance of the pose of j in i, in j, (6, 6), that some edges leave at `poses`.

        It takes milliseconds in graphs of a thousand poses, a quarter of a second in those of thousands.
        """
        factors = gtsam.NonlinearFactorGraph()
        for e in edges:
            factors.push_back(self.factors[e])
        planar = self._graph.planar
        factors.push_back(_hold_first(poses[0], planar))
        marginals = gtsam.Marginals(factors, to_values(poses, planar))
        rows = PLANAR[[1, 2, 0]] if planar else np.arange(6)

        def between(i: int, j: int) -> np.ndarray:
            joint = np.zeros((12, 12))
            both = np.concatenate([rows, rows + 6])
            # gtsam orders by key.
            joint[np.ix_(both, both)] = marginals.jointMarginalCovariance([min(i, j), max(i, j)]).fullMatrix()
            first, second = (0, 6) if i < j else (6, 0)
            to_ij = np.zeros((6, 12))
            to_ij[:, first : first + 6] = -adjoint(inverse(poses[j]) @ poses[i])
            to_ij[:, second : second + 6] = np.eye(6)
            return to_ij @ joint @ to_ij.T

        return between

    def chordal(self, edges: np.ndarray) -> np.ndarray | None:
        """Poses by relaxation of the rotations, then of the rest, (N, 4, 4); None where it fails.

        Carlone et al., Initialization techniques for 3D SLAM, ICRA 2015; in a plane see `planar_chordal`.
        """
        edges = edges[self._graph.kind[edges] != ATTITUDE]
        try:
            if self._graph.planar:
                poses = planar_chordal(self._graph, edges)
            else:
                factors = gtsam.NonlinearFactorGraph()
                for e in edges:
                    factors.push_back(self.factors[e])
                factors.push_back(_hold_first(self._graph.poses[0], False))
                poses = from_values(gtsam.InitializePose3.initialize(factors), False)
        except RuntimeError:
            return None
        if len(poses) != len(self._graph.poses) or not np.isfinite(poses).all():
            return None
        return self._graph.poses[0] @ np.linalg.inv(poses[0]) @ poses


def optimize(
    graph: PoseGraph,
    *,
    edges: np.ndarray | None = None,
    starts: Sequence[str] = STARTS,
    factors: Factors | None = None,
    max_iterations: int | None = None,
) -> Optimum:
    """The poses with the least Σ ξᵀ Ω ξ, from the best of several starts. The first pose stays where it is.

    Args:
        edges: which edges count, a mask (E,); all when not given.
        starts: which of `STARTS` are tried: the graph's poses, dead reckoning, chordal relaxation.
        factors: those of this graph, when they are there already.
        max_iterations: of the optimiser; enough to converge when not given.

    Raises:
        PoseGraphError: a pose hangs on no edge, or the chain of odometry has a gap and is the only start.
    """
    if len(graph.poses) == 0 or len(graph.i) == 0:
        return Optimum(graph.poses, np.zeros(len(graph.i)), "poses", 0)
    factors = factors or Factors(graph)
    used = np.arange(len(graph.i)) if edges is None else np.flatnonzero(edges)
    if (lonely := np.setdiff1d(np.arange(1, len(graph.poses)), np.union1d(graph.i[used], graph.j[used]))).size:
        raise PoseGraphError("a pose hangs on no edge", where="PoseGraph", value=int(lonely[0]))
    candidates: dict[str, np.ndarray] = {}
    if "poses" in starts:
        candidates["poses"] = graph.poses
    if "odometry" in starts:
        candidates["odometry"] = dead_reckoning(graph)
    if "chordal" in starts and (chordal := factors.chordal(used)) is not None:
        candidates["chordal"] = chordal
    start = next(iter(candidates))
    if len(candidates) > 1:
        costs = {name: chi_squared(graph, poses)[used].sum() for name, poses in candidates.items()}
        start = min(costs, key=lambda name: costs[name])
    poses, iterations = factors.optimize(candidates[start], used, max_iterations or _MAX_ITERATIONS)
    return Optimum(poses, chi_squared(graph, poses), start, iterations)


def to_values(poses: np.ndarray, planar: bool) -> gtsam.Values:
    """Poses (N, 4, 4) as gtsam holds them, keys 0 to N − 1."""
    values = gtsam.Values()
    if planar:
        yaw = np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
        for k, X in enumerate(poses):
            values.insert(k, gtsam.Pose2(X[0, 3], X[1, 3], yaw[k]))
    else:
        for k, X in enumerate(poses):
            values.insert(k, gtsam.Pose3(X))
    return values


def from_values(values: gtsam.Values, planar: bool) -> np.ndarray:
    """Poses (N, 4, 4) of `to_values`."""
    if planar:
        x, y, yaw = gtsam.utilities.extractPose2(values).T
        poses = np.tile(np.eye(4), (len(x), 1, 1))
        poses[:, 0, 0] = poses[:, 1, 1] = np.cos(yaw)
        poses[:, 1, 0] = np.sin(yaw)
        poses[:, 0, 1] = -poses[:, 1, 0]
        poses[:, 0, 3], poses[:, 1, 3] = x, y
        return poses
    rows = gtsam.utilities.extractPose3(values)
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, :3] = rows[:, :9].reshape(-1, 3, 3)
    poses[:, :3, 3] = rows[:, 9:]
    return poses


def _hold_first(X: np.ndarray, planar: bool) -> gtsam.NonlinearFactor:
    if planar:
        noise = gtsam.noiseModel.Isotropic.Sigma(3, _FIXED)
        return gtsam.PriorFactorPose2(0, gtsam.Pose2(X[0, 3], X[1, 3], np.arctan2(X[1, 0], X[0, 0])), noise)
    return gtsam.PriorFactorPose3(0, gtsam.Pose3(X), gtsam.noiseModel.Isotropic.Sigma(6, _FIXED))
