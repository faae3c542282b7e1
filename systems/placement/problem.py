"""All that the search for routes and landmarks needs to know of a plan, computed once: ways, scans, what is seen."""

import itertools
from dataclasses import dataclass, field

import numpy as np

from ..config import check_config, quantity
from .candidate_sites import SiteConfig, find_sites, initial_route, near_cells
from .floor_plan import FloorPlan
from .follow_kernels import Sides, Tables, Word, follow
from .information import InformationConfig, scans_along
from .landmarks import LandmarkConfig, LandmarkMap, find_landmarks
from .ray_kernels import straighten
from .side_sight import SideSight, look_to_the_sides
from .topology import Topology, TopologyConfig, drivable_cells, grow_topology


@dataclass(kw_only=True)
class ProblemConfig:
    """What routes and landmarks are planned for."""

    landmarks: LandmarkConfig = field(default_factory=LandmarkConfig)
    topology: TopologyConfig = field(default_factory=TopologyConfig)
    sites: SiteConfig = field(default_factory=SiteConfig)
    information: InformationConfig = field(default_factory=InformationConfig)
    # [m] Largest error of the robot's position that is allowed along the way; the paper's 500 mm less the 100 mm within
    # which it measures.
    error_limit: float = quantity(0.4, unit="m", above=0)
    # [m] Range within which the paper counts landmarks from a node.
    sight_range: float = quantity(15.0, unit="m", above=0)
    # Whether ways cut straight across where they can; the paper's go from cell to cell.
    straighten: bool = True


@dataclass(frozen=True, eq=False)
class PlacementProblem:
    """A plan, prepared for the search. Read-only.

    Point 0 is the start, points 1 … n are the measuring points. A leg from point a to point b has the number
    a (n + 1) + b.

    Attributes:
        plan, topology, landmarks: topology is that of ways that keep clear of all sites.
        sites: (k, 2) in W [m], k <= 62.
        lengths: (n + 1, n + 1) of the ways between points [m].
        ways: by leg, (m, 2) points in W [m].
        first: ((n + 1)² + 1,) where each leg's poses begin.
        poses: (p, 4) x, y, heading, and the length driven since the pose before [m, m, rad, m].
        base, added: information of the scans (p, 6), and what a box at each site adds (p, k, 6).
        limit: (p,) error that is allowed [m].
        sight: what is seen to the sides of the nodes, as the paper counts it.
        config: what it was made with.
    """

    plan: FloorPlan
    topology: Topology
    landmarks: LandmarkMap
    sites: np.ndarray
    lengths: np.ndarray
    ways: tuple[np.ndarray, ...]
    first: np.ndarray
    poses: np.ndarray
    base: np.ndarray
    added: np.ndarray
    limit: np.ndarray
    sight: SideSight
    config: ProblemConfig

    def __deepcopy__(self, memo: dict) -> "PlacementProblem":
        return self

    @property
    def points(self) -> np.ndarray:
        """(n + 1, 2) start and measuring points in W [m]."""
        return self.topology.nodes[: self.topology.fixed]

    def tables(self) -> Tables:
        """What the compiled search takes."""
        of = self.config.information
        at_start = np.array([of.start_position**2, of.start_heading**2, self.plan.start[2], of.sigmas])
        return Tables(self.lengths, self.first, self.poses, self.base, self.added, self.limit, of.odometry(), at_start)

    def sides(self) -> Sides:
        """What the paper's Eval takes."""
        return self.sight.sides()

    def errors_along(self, order: np.ndarray, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Poses (m, 3) along a route [m, m, rad], and the largest error to expect at each [m].

        Args:
            order: (n,) of the points 1 … n. chosen: (k,) bool, which sites have a box.
        """
        legs = np.concatenate([[0], order[:-1]]) * len(self.lengths) + order
        at = np.concatenate([np.arange(self.first[leg], self.first[leg + 1]) for leg in legs])
        errors = np.zeros(len(at))
        follow(np.asarray(order, np.int64), word_of(chosen), self.tables(), errors)
        return self.poses[at, :3], errors


def word_of(chosen: np.ndarray) -> np.int64:
    """The word with a bit for each of `chosen` (k,) bool, k <= 62."""
    return np.bitwise_or.reduce(np.left_shift(np.int64(1), np.flatnonzero(chosen)), initial=np.int64(0))


def sites_of(word: Word, count: int) -> np.ndarray:
    """(count,) bool: the bits of a word."""
    return (np.right_shift(np.int64(word), np.arange(count)) & 1).astype(bool)


def make_problem(plan: FloorPlan, config: ProblemConfig | None = None) -> PlacementProblem:
    """Finds landmarks, topology and sites of a plan, and all ways between its points.

    Raises:
        ConfigError: a value of `config` is out of range.
        PlanError: a point in a wall or without a way to it, or no place for a landmark.
    """
    config = config or ProblemConfig()
    landmarks, topology = find_landmarks(plan, config.landmarks), grow_topology(plan, config.topology)
    sites = find_sites(plan, topology, initial_route(topology), landmarks.positions, config.sites)
    return problem_with(plan, topology, landmarks, sites, config)


def problem_with(
    plan: FloorPlan, topology: Topology, landmarks: LandmarkMap, sites: np.ndarray, config: ProblemConfig | None = None
) -> PlacementProblem:
    """The same, with landmarks, topology and sites that are given."""
    config = config or ProblemConfig()
    check_config(config, key="problem")
    drivable = drivable_cells(plan, config.topology.clearance) & ~near_cells(plan, sites, config.sites.room)
    clear = topology.kept_to(plan, drivable)
    n = clear.fixed
    nodes: list[np.ndarray] = []
    ways: list[np.ndarray] = []
    for a in range(n):
        for b in range(n):
            path = clear.path(a, b)[0] if b > 0 and a != b else np.zeros(0, np.int64)
            way = clear.nodes[path]
            nodes.append(path)
            ways.append(_straight(plan, ~drivable, way) if config.straighten else way)
    step = config.information.step
    legs = [_poses(way, step) for way in ways]
    poses = np.concatenate(legs)
    base, added = scans_along(plan, poses[:, :3], sites, config.sites.side, config.information)
    lengths = np.array([leg[:, 3].sum() for leg in legs]).reshape(n, n)
    sight = look_to_the_sides(plan, clear, nodes, landmarks, sites, config.sites.side, config.sight_range)
    return PlacementProblem(
        plan,
        clear,
        landmarks,
        sites,
        lengths,
        tuple(ways),
        _starts(legs),
        poses,
        base,
        added,
        np.full(len(poses), config.error_limit),
        sight,
        config,
    )


def _straight(plan: FloorPlan, blocked: np.ndarray, way: np.ndarray) -> np.ndarray:
    """A way (k, 2) with all cuts that are clear, at first between its points, then also between points along it."""
    for spacing in (np.inf, 1.0, 0.5):
        if len(way) <= 2:
            break
        parts = [way[:1]]
        for a, b in itertools.pairwise(way):
            count = max(1, int(np.ceil(np.hypot(*(b - a)) / spacing)))
            parts.append(a + (b - a) * (np.arange(1, count + 1) / count)[:, None])
        fine = np.concatenate(parts)
        way = fine[straighten(blocked, (fine - plan.origin) / plan.resolution)]
    return way


def _starts(parts: list[np.ndarray]) -> np.ndarray:
    return np.concatenate([[0], np.cumsum([len(part) for part in parts])]).astype(np.int64)


def _poses(way: np.ndarray, step: float) -> np.ndarray:
    """(m, 4) poses at most `step` [m] apart along a way (k, 2), its first point left out."""
    parts = [np.zeros((0, 4))]
    for a, b in itertools.pairwise(way):
        length = float(np.hypot(*(b - a)))
        count = max(1, int(np.ceil(length / step - 1e-9)))
        at = a + (b - a) * (np.arange(1, count + 1) / count)[:, None]
        heading = np.arctan2(*(b - a)[::-1])
        parts.append(np.column_stack([at, np.full(count, heading), np.full(count, length / count)]))
    return np.concatenate(parts)
