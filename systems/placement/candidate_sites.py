"""Where a landmark may be added: cells beside the route, not on it (S4-c)."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label
from scipy.spatial import KDTree

from ..config import check_config, quantity
from ..errors import PlanError
from .floor_plan import FloorPlan
from .topology import Topology


@dataclass(kw_only=True)
class SiteConfig:
    """Where landmarks may be added."""

    # [m] Kept from other landmarks by a site that is linked with the route over another cell; no number in the paper.
    spacing: float = quantity(5.0, unit="m", above=0)
    # [m] a: a cell linked with the route is a site when no landmark is nearer; the paper's third of the laser's range.
    near: float = quantity(10.0, unit="m", above=0)
    # [m] Side of the box that is put there.
    side: float = quantity(0.5, unit="m", above=0)
    # [m] Kept by a box from the robot's way and from measuring points, middle to middle: half of the box's diagonal,
    # half of the robot, and a margin.
    room: float = quantity(0.9, unit="m", above=0)
    # Sites at most, those farthest from all others: the paper's 24. Sets of them are held in the bits of one word.
    most: int = quantity(24, unit="sites", low=1, high=62)


def initial_route(topology: Topology) -> np.ndarray:
    """Nodes along the ways from the start through the measuring points in the order of the plan (section 3.1)."""
    legs = [topology.path(k, k + 1)[0] for k in range(topology.fixed - 1)]
    if not all(len(leg) for leg in legs):
        raise PlanError("no way between the measuring points", key="topology")
    return np.concatenate([legs[0], *(leg[1:] for leg in legs[1:])])


def find_sites(
    plan: FloorPlan, topology: Topology, route: np.ndarray, landmarks: np.ndarray, config: SiteConfig | None = None
) -> np.ndarray:
    """Places (k, 2) [m] where a box may be put as a landmark (S4-c; paper, section 3.2).

    They are cells off the route:
    - linked with it over one other cell, when other landmarks are `spacing` away, or
    - linked with it directly, when no landmark is within `near`.
    Sites that are found count as landmarks for the next one; the cell farthest from all of them comes first. A box that
    would leave no way past it, as in a door, is left out.

    Args:
        route: (n,) nodes, see `initial_route`. landmarks: (m, 2) of the plan itself [m].

    Raises:
        ConfigError: a value of `config` is out of range.
        PlanError: there is no site.
    """
    config = config or SiteConfig()
    check_config(config, key="sites")
    on_route = np.zeros(len(topology.nodes), bool)
    on_route[route] = True
    beside = _beside(topology, on_route)
    behind = _beside(topology, beside | on_route) & ~on_route
    required = np.where(behind, config.spacing, config.near)
    possible = np.flatnonzero((beside | behind) & _has_room(plan, topology, config))
    sites: list[np.ndarray] = []
    gap = _distance(topology.nodes[possible], landmarks)
    drivable = plan.clearance() > config.room - _half_diagonal(config.side)
    while len(sites) < config.most and len(possible):
        margin = gap - required[possible]
        k = int(np.argmax(margin))
        if margin[k] <= 0:
            break
        site = topology.nodes[possible[k]]
        closed = drivable & ~near_cells(plan, site[None], config.room)
        if not _all_linked(plan, closed):
            gap[k] = 0.0
            continue
        drivable = closed
        sites.append(site)
        gap = np.minimum(gap, _distance(topology.nodes[possible], site[None]))
    if not sites:
        valid = f"free cells beside the route, {config.near:g} m from all landmarks; a smaller sites.near or spacing"
        raise PlanError("no place for a landmark", key="sites", valid=valid)
    return np.array(sites)


def near_cells(plan: FloorPlan, sites: np.ndarray, distance: float) -> np.ndarray:
    """(rows, cols) cells with their middle nearer than `distance` [m] to one of `sites` (k, 2) [m]."""
    near = np.zeros(plan.occupied.shape, bool)
    reach = int(np.ceil(distance / plan.resolution)) + 1
    for site, (i, j) in zip(sites, plan.cell_of(sites).tolist(), strict=True):
        rows, cols = slice(max(i - reach, 0), i + reach + 1), slice(max(j - reach, 0), j + reach + 1)
        part = near[rows, cols]
        cells = np.moveaxis(np.indices(part.shape), 0, -1) + np.array([rows.start, cols.start])
        part |= np.hypot(*np.moveaxis(plan.centre_of(cells) - site, -1, 0)) < distance
    return near


def _half_diagonal(side: float) -> float:
    return 0.5 * float(np.hypot(side, side))


def _all_linked(plan: FloorPlan, drivable: np.ndarray) -> bool:
    """Whether start and measuring points are in one region of `drivable` (rows, cols)."""
    regions, _ = label(drivable)
    cells = plan.cell_of(np.vstack([plan.start[:2], plan.measuring_points]))
    found = regions[tuple(cells.T)]
    return bool(found[0] > 0 and (found == found[0]).all())


def _beside(topology: Topology, nodes: np.ndarray) -> np.ndarray:
    """(n,) which nodes are linked with one of `nodes` (n,) bool and are none of them."""
    a, b = topology.links.T
    linked = np.zeros(len(nodes), bool)
    linked[a[nodes[b]]] = True
    linked[b[nodes[a]]] = True
    return linked & ~nodes


def _has_room(plan: FloorPlan, topology: Topology, config: SiteConfig) -> np.ndarray:
    """(n,) which nodes are cells where a box touches no wall and keeps clear of start and measuring points."""
    cells = plan.cell_of(topology.nodes)
    room = plan.clearance()[tuple(cells.T)] > config.side
    room[: topology.fixed] = False
    return room & (_distance(topology.nodes, topology.nodes[: topology.fixed]) > config.room)


def _distance(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(n,) distance of every point to the nearest of the others [m], infinite when there is none."""
    if not len(others):
        return np.full(len(points), np.inf)
    return KDTree(others).query(points)[0]
