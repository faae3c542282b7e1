"""Maps with closed loops: localisation on submaps, loops by correlative search, poses by the pose graph.

The localiser follows the robot on a submap of the last keyframes, which drifts but never tears. Finished submaps are
searched for the newest keyframe wherever the graph says that it may be near; what is found is a loop. `decide_loops`
says which to believe, and the graph is optimised; the map is laid out from all keyframes at its poses.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from ..config import check_config, quantity
from ..errors import ConfigError
from ..pose_graph import LOOP, REGISTRATION, PoseGraph, RobustLoopsConfig, decide_loops
from .correlative_search import CorrelativeSearchConfig, SearchImage, correlative_search, make_search_image
from .laser_scan import LaserScan
from .likelihood_field import LikelihoodField, make_field
from .localizer_config import LocalizerConfig
from .match_kernels import find_patches, refine
from .occupancy_grid import OccupancyGrid
from .planar import between, compose, from_matrix, inverse, to_matrix, transform, turned
from .scan_localization import Localization, localize, motion_since, start_localization, usable_points
from .uncertainty import PlanarOdometryAccuracy, information_of, odometry_step_covariance


@dataclass(kw_only=True)
class GraphMappingConfig:
    """Submaps, loops and what is trusted."""

    localizer: LocalizerConfig = field(
        default_factory=lambda: LocalizerConfig(
            mapping=True,
            keyframe_distance=0.3,
            keyframe_angle_deg=10.0,
            # Old robots whose odometry and laser are not timed together.
            odometry=PlanarOdometryAccuracy(along=0.1, across=0.05, heading_deg=3.0, turn_deg=6.0),
        )
    )
    search: CorrelativeSearchConfig = field(default_factory=CorrelativeSearchConfig)
    # [keyframes] A new submap is begun after so many; the one before is localised on until the new one has as many.
    submap_keyframes: int = quantity(25, unit="keyframes", low=2)
    # [keyframes] Every so many, loops are looked for, in the nearest `candidates` submaps.
    search_every: int = quantity(2, unit="keyframes", low=1)
    candidates: int = quantity(2, unit="submaps", low=1)
    # [m] A submap whose keyframes are all farther than this from where the graph puts the robot is no candidate.
    near: float = quantity(3.0, unit="m", above=0)
    # [-] Least score of a loop: mean likelihood of the scan on the submap; and least part of its beams that meet it.
    min_score: float = quantity(0.55, unit="-", above=0, high=1)
    min_overlap: float = quantity(0.6, unit="-", above=0, high=1)
    # [m], [deg] Added to the deviation of every edge: neighbouring scans share their errors.
    edge_deviation: float = quantity(0.01, unit="m", above=0)
    edge_deviation_deg: float = quantity(0.15, unit="deg", above=0)
    loop_deviation: float = quantity(0.04, unit="m", above=0)
    loop_deviation_deg: float = quantity(0.4, unit="deg", above=0)
    # [loops] After so many new ones, and a tenth of those that are known, the graph is optimised.
    optimize_every: int = quantity(25, unit="loops", low=1)
    robust: RobustLoopsConfig = field(default_factory=lambda: RobustLoopsConfig(false_reach=3.0))


@dataclass(frozen=True, eq=False)
class MapKeyframe:
    """A scan in the map: points p_BP (n, 2) [m], its pose `local` (3,) by the localiser, number of the scan."""

    points: np.ndarray
    local: np.ndarray
    scan: int


@dataclass(frozen=True, eq=False)
class Submap:
    """A finished submap of keyframes `first` to `last`, in the axes of the localiser."""

    first: int
    last: int
    likelihood: LikelihoodField
    image: SearchImage


class GraphMapper:
    """Takes in scans one by one; `finish` gives the map.

    Attributes:
        keyframes: as they came. poses: of all keyframes by the graph, (K, 3), in M, the axes of the first.
        steps: for every scan, its keyframe and its pose in it, (keyframe, (3,)).
        loops: (i, j, X_ij, information) of all candidates that fitted; accepted: which of them the graph believes.

    Raises:
        ConfigError: a value of `config` is out of range, or its localiser is the paper's.
    """

    def __init__(self, config: GraphMappingConfig | None = None, *, X_BS: np.ndarray | None = None, seed: int = 0):
        self.config = config or GraphMappingConfig()
        check_config(self.config, key="graph_mapping")
        if self.config.localizer.method == "paper":
            problem = "it makes no likelihood field, which loops are matched to"
            raise ConfigError(problem, key="graph_mapping.localizer.method", value="paper", valid="naraha")
        self._X_BS, self._seed = X_BS, seed
        self._known: Localization = start_localization(self.config.localizer)
        self._next = OccupancyGrid.empty(self.config.localizer.occupancy)
        self._next_first, self._current_first = -1, 0
        self.keyframes: list[MapKeyframe] = []
        self.submaps: list[Submap] = []
        self.poses = np.zeros((0, 3))
        self.steps: list[tuple[int, np.ndarray]] = []
        self.loops: list[tuple[int, int, np.ndarray, np.ndarray]] = []
        self.accepted = np.zeros(0, bool)
        self._edges: list[tuple[np.ndarray, np.ndarray]] = []
        self._decided = 0

    def add_scan(self, scan: LaserScan, X_OB: np.ndarray) -> None:
        """Localises a scan; when it becomes a keyframe, looks for loops and optimises where it is time to."""
        before = self._known
        known = localize(before, scan, X_OB, self.config.localizer, X_BS=self._X_BS, seed=self._seed)
        self._known = known
        if len(known.keyframes) > len(self.keyframes):
            motion = motion_since(before, scan, X_OB)
            self._add_keyframe(usable_points(scan, self.config.localizer, self._X_BS, *motion), known)
        k = len(self.keyframes) - 1
        if k >= 0:
            self.steps.append((k, between(self.keyframes[k].local, known.pose)))

    @property
    def pose(self) -> np.ndarray:
        """X_MB (3,) now, by graph and localiser."""
        return compose(self.poses[self.steps[-1][0]], self.steps[-1][1]) if self.steps else self._known.pose

    def trajectory(self) -> np.ndarray:
        """X_MB of every scan, (n, 3)."""
        return np.array([compose(self.poses[k], X) for k, X in self.steps])

    def open_trajectory(self) -> np.ndarray:
        """The same by the localiser alone, without loops, (n, 3)."""
        return np.array([compose(self.keyframes[k].local, X) for k, X in self.steps])

    def make_map(self, poses: np.ndarray | None = None) -> OccupancyGrid:
        """The map of all keyframes at the poses of the graph, or at others (K, 3)."""
        grid = OccupancyGrid.empty(self.config.localizer.occupancy)
        poses = self.poses if poses is None else poses
        for k, (keyframe, X) in enumerate(zip(self.keyframes, poses, strict=True)):
            grid = self._entered(grid, keyframe, X, k)
        return grid

    def finish(self) -> OccupancyGrid:
        """Judges all loops anew, optimises, and gives the map."""
        self._optimize()
        return self.make_map()

    def graph(self, loops: np.ndarray | None = None) -> PoseGraph:
        """Keyframes, edges between successive ones, and loops, all or a mask of them (L,)."""
        chosen = [loop for k, loop in enumerate(self.loops) if loops is None or loops[k]]
        count = len(self._edges)
        steps = [X for X, _ in self._edges] + [X for _, _, X, _ in chosen]
        information = np.zeros((count + len(chosen), 6, 6))
        for e, block in enumerate([w for _, w in self._edges] + [w for *_, w in chosen]):
            # [roll, pitch, yaw, x, y, z] against (x, y, heading).
            information[e][np.ix_([3, 4, 2], [3, 4, 2])] = block
        return PoseGraph(
            to_matrix(self.poses),
            np.array([*range(count), *(i for i, *_ in chosen)], int),
            np.array([*range(1, count + 1), *(j for _, j, *_ in chosen)], int),
            to_matrix(np.array(steps).reshape(-1, 3)),
            information,
            np.array([REGISTRATION] * count + [LOOP] * len(chosen), int),
            planar=True,
        )

    def _add_keyframe(self, points: np.ndarray, known: Localization) -> None:
        local, k = known.keyframes[-1], len(self.keyframes)
        keyframe = MapKeyframe(points, local, known.scans - 1)
        self.keyframes.append(keyframe)
        if k == 0:
            self.poses = local[None].copy()
        else:
            step = between(self.keyframes[k - 1].local, local)
            self.poses = np.vstack([self.poses, compose(self.poses[-1], step)])
            odometry = odometry_step_covariance(step, self.config.localizer.odometry) + 1e-9 * np.eye(3)
            # The step's error is in the axes of the keyframe; what the scan told is in those of the submap.
            information = np.linalg.inv(odometry) + _into_body(known.information, local)
            floor = _floor(self.config.edge_deviation, self.config.edge_deviation_deg)
            self._edges.append((step, np.linalg.inv(np.linalg.inv(information) + floor)))
        self._roll_submaps(keyframe, k)
        if k % self.config.search_every == 0:
            self._find_loops(k)
        if len(self.loops) - self._decided >= max(self.config.optimize_every, 0.1 * self._decided):
            self._optimize()

    def _roll_submaps(self, keyframe: MapKeyframe, k: int) -> None:
        """Enters the keyframe into the submap to come; takes that one when it is large enough."""
        size = self.config.submap_keyframes
        if self._next_first < 0 and k + 1 - self._current_first >= size:
            self._next_first = k
        if self._next_first < 0:
            return
        self._next = self._entered(self._next, keyframe, keyframe.local, k)
        if k + 1 - self._next_first >= size:
            known, reach = self._known, self.config.localizer.reach
            image = make_search_image(known.likelihood, self.config.search)
            first = self._current_first
            self.submaps.append(Submap(first, k, known.likelihood, image))
            self._known = replace(known, grid=self._next, likelihood=make_field(self._next, reach))
            self._current_first, self._next_first = self._next_first, k
            empty = OccupancyGrid.empty(self.config.localizer.occupancy)
            self._next = self._entered(empty, keyframe, keyframe.local, k)

    def _entered(self, grid: OccupancyGrid, keyframe: MapKeyframe, X: np.ndarray, k: int) -> OccupancyGrid:
        X_BS = np.zeros(3) if self._X_BS is None else self._X_BS
        points = transform(inverse(X_BS), keyframe.points)
        return grid.with_scan(points, compose(X, X_BS), self.config.localizer.occupancy, number=k)

    def _find_loops(self, k: int) -> None:
        here = self.poses[k, :2]
        candidates = []
        for n, submap in enumerate(self.submaps):
            if submap.last + self.config.submap_keyframes > k:
                continue
            distance = np.linalg.norm(self.poses[submap.first : submap.last + 1, :2] - here, axis=1).min()
            if distance < self.config.near:
                candidates.append((distance, n))
        for _, n in sorted(candidates)[: self.config.candidates]:
            loop = self._match_submap(k, self.submaps[n])
            if loop is not None:
                self.loops.append(loop)
                self.accepted = np.append(self.accepted, False)

    def _match_submap(self, k: int, submap: Submap) -> tuple[int, int, np.ndarray, np.ndarray] | None:
        """A loop to keyframe k from the one of the submap next to it, where the scan lies on the submap well enough.

        A submap bends a little over its length; the place next to where the scan lies is what it lies on.
        """
        config, keyframe = self.config, self.keyframes[k]
        inside = slice(submap.first, submap.last + 1)
        nearest = submap.first + _nearest(self.poses[inside], self.poses[k])
        # Where the graph expects the keyframe, in the axes that the submap was made in.
        expected = compose(self.keyframes[nearest].local, between(self.poses[nearest], self.poses[k]))
        found, score, rival = correlative_search(submap.image, keyframe.points, expected, config.search)
        if score < config.min_score:
            return None
        lf, c = submap.likelihood, config.localizer
        step = max(len(keyframe.points) // c.beams, 1)
        points = np.ascontiguousarray(keyframe.points[::step])
        weak = np.diag([1.0, 1.0, 1 / math.radians(5) ** 2])
        refined, A, T, used = refine(
            lf.signed, lf.origin[0], lf.origin[1], lf.resolution, lf.reach / lf.resolution, points,
            find_patches(points, c.patch_length), found, found, weak,
            c.beam_deviation, c.map_deviation, c.robust_deviation, 20,
        )  # fmt: skip
        if used < config.min_overlap * len(points):
            return None
        information = information_of(A, T, math.radians(c.mapped_normal_deviation_deg)) + 1e-3 * np.eye(3)
        floor = _floor(config.loop_deviation, config.loop_deviation_deg)
        covariance = np.linalg.inv(information)
        covariance[:2, :2] += np.outer(rival, rival)  # it may be there as well
        covariance = turned(covariance, -refined[2]) + floor
        local = np.array([one.local for one in self.keyframes[inside]])
        anchor = submap.first + _nearest(local, refined)
        return anchor, k, between(local[anchor - submap.first], refined), np.linalg.inv(covariance)

    def _optimize(self) -> None:
        if not self.loops:
            return
        graph = self.graph()
        decision = decide_loops(
            graph, self.config.robust, believed=np.append(np.zeros(len(self._edges), bool), self.accepted)
        )
        self.accepted = decision.accepted[len(self._edges) :]
        self.poses = from_matrix(decision.poses)
        self._decided = len(self.loops)


def _nearest(poses: np.ndarray, X: np.ndarray) -> int:
    return int(np.argmin(np.linalg.norm(poses[:, :2] - X[:2], axis=1)))


def _floor(deviation: float, degrees: float) -> np.ndarray:
    return np.diag([deviation**2, deviation**2, math.radians(degrees) ** 2])


def _into_body(information: np.ndarray, X: np.ndarray) -> np.ndarray:
    """Information about (x, y, heading) in the axes of a map, in those of a body at X."""
    c, s = math.cos(X[2]), math.sin(X[2])
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return R.T @ information @ R
