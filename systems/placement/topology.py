"""Topology of the free space of a plan: cells grown over it, and the start and the measuring points joined (S4-b)."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import KDTree

from ..config import check_config, quantity
from ..errors import PlanError
from .astar import find_path
from .cell_kernels import grow_cells
from .floor_plan import FloorPlan
from .grid_links import grid_way
from .ray_kernels import clear_table


@dataclass(kw_only=True)
class TopologyConfig:
    """How cells are grown over the free space."""

    # [m] Mean distance of neighbouring cells that is aimed at.
    spacing: float = quantity(2.5, unit="m", above=0)
    # [m] Kept from walls, to the robot's middle: half of the robot's width and a margin.
    clearance: float = quantity(0.5, unit="m", above=0)
    # Signals between two insertions, and for each cell afterwards, while the rates fall.
    signals: int = quantity(100, unit="signals", low=1)
    settling: int = quantity(100, unit="signals", low=0)
    # [-] Rates of the nearest cell and of its neighbours; Fritzke's values.
    winner_rate: float = quantity(0.06, above=0, high=1)
    neighbour_rate: float = quantity(0.002, low=0, high=1)
    # [-] Share by which all counters fall at every signal.
    decay: float = quantity(0.0005, low=0, high=1)
    # Nearest cells in sight that the start and each measuring point are linked with.
    joins: int = quantity(4, unit="cells", low=1)
    # The same seed gives the same topology.
    seed: int = quantity(0, low=0)


@dataclass(frozen=True, eq=False)
class Topology:
    """A graph over the free space. Read-only.

    Attributes:
        nodes: (n, 2) in W [m]: start, then the measuring points, then the cells.
        fixed: number of nodes that are the start or a measuring point.
        links: (m, 2) pairs of nodes, each once.
        first, neighbour, length: the links by node, as `find_path` takes them [m].
    """

    nodes: np.ndarray
    fixed: int
    links: np.ndarray
    first: np.ndarray
    neighbour: np.ndarray
    length: np.ndarray

    def __deepcopy__(self, memo: dict) -> "Topology":
        return self

    @staticmethod
    def of(nodes: np.ndarray, fixed: int, links: np.ndarray) -> "Topology":
        """The graph of `nodes` (n, 2) [m] and `links` (m, 2)."""
        links = np.unique(np.sort(np.asarray(links, np.int64).reshape(-1, 2), axis=1), axis=0)
        both = np.vstack([links, links[:, ::-1]])
        both = both[np.lexsort((both[:, 1], both[:, 0]))]
        first = np.searchsorted(both[:, 0], np.arange(len(nodes) + 1))
        length = np.hypot(*(nodes[both[:, 0]] - nodes[both[:, 1]]).T)
        return Topology(nodes, fixed, links, first, np.ascontiguousarray(both[:, 1]), length)

    def path(self, start: int, goal: int) -> tuple[np.ndarray, float]:
        """Nodes along the shortest way, and its length [m]; none and infinite when there is none."""
        return find_path(self.nodes, self.first, self.neighbour, self.length, start, goal)

    def kept_to(self, plan: FloorPlan, drivable: np.ndarray) -> "Topology":
        """The topology with its links cut that leave `drivable` (rows, cols), and what that takes apart linked again.

        Raises `PlanError` when there is no way left to a measuring point.
        """
        stands = drivable[tuple(np.clip(plan.cell_of(self.nodes), 0, np.array(drivable.shape) - 1).T)]
        stands[: self.fixed] = True
        number = np.cumsum(stands) - 1
        links = number[self.links[stands[self.links].all(axis=1)]]
        nodes = self.nodes[stands]
        return Topology.of(*_linked(plan, drivable, nodes, self.fixed, _clear_links(plan, drivable, nodes, links)))

    def neighbours(self, node: int) -> np.ndarray:
        """Nodes that are linked with `node`."""
        return self.neighbour[self.first[node] : self.first[node + 1]]


def drivable_cells(plan: FloorPlan, clearance: float) -> np.ndarray:
    """(rows, cols) cells that the robot's middle reaches from the start, `clearance` [m] away from walls."""
    regions, _ = label(plan.clearance() > clearance)
    start = regions[tuple(plan.cell_of(plan.start[:2]))]
    return (regions == start) & (start > 0)


def grow_topology(plan: FloorPlan, config: TopologyConfig | None = None) -> Topology:
    """Grows cells over the free space and links them where the robot can drive straight (S4-b; paper, section 3.1).

    Links across walls are cut. The start and every measuring point become nodes, linked with the nearest cells. What is
    cut off by that, such as a room behind a narrow door, is linked again by the shortest way over the plan's grid.

    Raises:
        ConfigError: a value of `config` is out of range.
        PlanError: start or measuring points cannot be reached, see `FloorPlan.check`.
    """
    config = config or TopologyConfig()
    check_config(config, key="topology")
    plan.check(clearance=config.clearance)
    drivable = drivable_cells(plan, config.clearance)
    places, grown = _grown(plan, drivable, config)
    nodes = np.vstack([plan.start[:2], plan.measuring_points, places])
    fixed = 1 + len(plan.measuring_points)
    joins = _joins(nodes, fixed, config.joins)
    links = np.vstack([np.argwhere(np.triu(grown)) + fixed, joins])
    links = _clear_links(plan, drivable, nodes, links)
    slits = _clear_links(plan, drivable, nodes, _slits(nodes, links, 1.5 * config.spacing))
    return Topology.of(*_linked(plan, drivable, nodes, fixed, np.vstack([links, slits])))


def _clear_links(plan: FloorPlan, drivable: np.ndarray, nodes: np.ndarray, links: np.ndarray) -> np.ndarray:
    """Those of `links` along which the robot can drive."""
    return links[clear_table(~drivable, (nodes - plan.origin) / plan.resolution, links)]


def _slits(nodes: np.ndarray, links: np.ndarray, gap: float) -> np.ndarray:
    """Pairs of nodes nearer than `gap` [m] that are more than three links apart: two sides of a slit, which cells leave
    that have grown towards each other."""
    near = KDTree(nodes).query_pairs(gap, output_type="ndarray").astype(np.int64)
    graph = csr_matrix((np.ones(len(links)), links.T), (len(nodes), len(nodes)))
    hops = dijkstra(graph, directed=False, unweighted=True, limit=3)
    return near[np.isinf(hops[near[:, 0], near[:, 1]])]


def _grown(plan: FloorPlan, drivable: np.ndarray, config: TopologyConfig) -> tuple[np.ndarray, np.ndarray]:
    """Cells (n, 2) [m] that the robot can stand on, and their links (n, n)."""
    rng = np.random.default_rng(config.seed)
    free = np.argwhere(drivable)
    # A mesh of equilateral triangles has a node for every 0.87 squares of its spacing.
    most = max(4, round(len(free) * plan.resolution**2 / (0.866 * config.spacing**2)))
    chosen = free[rng.integers(len(free), size=most * (config.signals + config.settling))]
    signals = plan.centre_of(chosen) + rng.uniform(-0.5, 0.5, chosen.shape) * plan.resolution
    places, links = grow_cells(signals, most, config.signals, (config.winner_rate, config.neighbour_rate), config.decay)
    cells = plan.cell_of(places)
    stands = drivable[tuple(np.clip(cells, 0, np.array(drivable.shape) - 1).T)]
    return places[stands], links[np.ix_(stands, stands)]


def _joins(nodes: np.ndarray, fixed: int, count: int) -> np.ndarray:
    """(k, 2) links of the fixed nodes with their nearest cells; twice as many, for some may be behind a wall."""
    cells = len(nodes) - fixed
    if not cells:
        return np.zeros((0, 2), np.int64)
    _, near = KDTree(nodes[fixed:]).query(nodes[:fixed], min(count, cells))
    near = near.reshape(fixed, -1) + fixed
    return np.column_stack([np.repeat(np.arange(fixed), near.shape[1]), near.ravel()])


def _linked(
    plan: FloorPlan, drivable: np.ndarray, nodes: np.ndarray, fixed: int, links: np.ndarray
) -> tuple[np.ndarray, int, np.ndarray]:
    """Nodes and links with the parts of the graph that are apart from the start's linked by ways over the grid."""
    while True:
        n = len(nodes)
        graph = csr_matrix((np.ones(len(links)), links.T), (n, n))
        _, part = connected_components(graph, directed=False)
        if (part == part[0]).all():
            return nodes, fixed, links
        apart = np.flatnonzero(part != part[0])
        together = np.flatnonzero(part == part[0])
        gaps, nearest = KDTree(nodes[together]).query(nodes[apart])
        k = int(np.argmin(gaps))
        way = grid_way(plan, drivable, nodes[apart[k]], nodes[together[nearest[k]]])
        if way is None:
            raise PlanError("no way leads there", key="topology", value=nodes[apart[k]].round(3).tolist())
        between = np.arange(n, n + len(way))
        chain = np.concatenate([[apart[k]], between, [together[nearest[k]]]])
        nodes = np.vstack([nodes, way])
        links = np.vstack([links, np.column_stack([chain[:-1], chain[1:]])])
