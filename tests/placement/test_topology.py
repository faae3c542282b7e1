"""Topology: cells over the free space alone, everything linked, shortest ways; sites beside the route."""

import itertools

import numpy as np
import pytest
from naraha.models.plans import load_floor_plan
from naraha.systems.errors import PlanError
from naraha.systems.placement import (
    SiteConfig,
    TopologyConfig,
    find_landmarks,
    find_sites,
    grow_topology,
    initial_route,
)
from naraha.systems.placement.grid_links import grid_path, grid_way
from naraha.systems.placement.topology import Topology, drivable_cells
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from .halls import POINTS, hall, lines


def crosses(plan, a, b):
    along = a + (b - a) * np.linspace(0, 1, 400)[:, None]
    return plan.is_occupied(along).any()


def test_cells_fill_the_free_space_evenly_and_no_link_crosses_a_wall():
    plan = hall(lines((14, 0.1), (14, 9)))
    topology = grow_topology(plan)
    drivable = plan.centre_of(np.argwhere(drivable_cells(plan, 0.5)))
    gaps = KDTree(topology.nodes).query(drivable)[0]
    assert np.median(gaps) < 0.5 * 2.5
    assert gaps.max() < 1.5 * 2.5
    assert not any(crosses(plan, *topology.nodes[link]) for link in topology.links)
    lengths = np.hypot(*(topology.nodes[topology.links[:, 0]] - topology.nodes[topology.links[:, 1]]).T)
    assert 0.7 * 2.5 < np.median(lengths) < 1.3 * 2.5


def test_the_same_seed_gives_the_same_topology_and_another_one_another():
    one, same, other = (grow_topology(hall(), TopologyConfig(seed=seed)) for seed in (3, 3, 4))
    assert (one.nodes == same.nodes).all()
    assert len(one.nodes) != len(other.nodes) or (one.nodes != other.nodes).any()


def test_start_and_points_come_first_and_are_linked_with_their_nearest_cells():
    plan = hall()
    topology = grow_topology(plan)
    assert (topology.nodes[: topology.fixed] == np.vstack([plan.start[:2], POINTS])).all()
    for k in range(topology.fixed):
        assert len(topology.neighbours(k)) >= 3
        gap = np.hypot(*(topology.nodes[topology.neighbours(k)] - topology.nodes[k]).T)
        assert gap.max() < 2 * 2.5


def test_a_room_behind_a_narrow_door_is_linked():
    wall = np.concatenate([lines((22, 0.1), (22, 7.3)), lines((22, 8.7), (22, 15.9))])
    plan = hall(wall)
    topology = grow_topology(plan, TopologyConfig(spacing=4.0))
    nodes, length = topology.path(1, 3)
    assert np.isfinite(length)
    assert not any(crosses(plan, *topology.nodes[[a, b]]) for a, b in itertools.pairwise(nodes))
    with pytest.raises(PlanError, match=r"measuring_points\[2\].*no way"):
        grow_topology(hall(lines((22, 0.1), (22, 15.9))))


def test_astar_finds_the_ways_that_dijkstra_does():
    rng = np.random.default_rng(5)
    nodes = rng.uniform(0, 10, (200, 2))
    topology = Topology.of(nodes, 2, KDTree(nodes).query_pairs(1.1, output_type="ndarray"))
    a, b = topology.links.T
    length = np.hypot(*(nodes[a] - nodes[b]).T)
    expected = dijkstra(coo_matrix((length, (a, b)), (200, 200)).tocsr(), directed=False)
    pairs = rng.integers(0, 200, (300, 2))
    found = [topology.path(int(a), int(b)) for a, b in pairs]
    assert [total for _, total in found] == pytest.approx(expected[tuple(pairs.T)].tolist())
    for (path, total), (start, goal) in zip(found, pairs, strict=True):
        if np.isfinite(total):
            assert (path[0], path[-1]) == (start, goal)
            assert np.hypot(*np.diff(nodes[path], axis=0).T).sum() == pytest.approx(total)
        else:
            assert not len(path)


def test_ways_over_the_plain_grid_are_shortest():
    drivable = np.ones((30, 40), bool)
    drivable[5:, 20] = False
    path = grid_path(drivable, np.array([25, 5]), np.array([25, 35]))
    assert (path[0].tolist(), path[-1].tolist()) == ([25, 5], [25, 35])
    assert drivable[tuple(path.T)].all()
    # Up to row 4 past the wall and down again: 30 columns, 42 rows, no corner cut.
    steps = np.abs(np.diff(path, axis=0))
    assert steps.max() == 1
    diagonal = int((steps.sum(axis=1) == 2).sum())
    assert (diagonal, len(steps)) == (28, 44)


def test_a_grid_way_bends_at_corners_alone():
    plan = hall(lines((14, 0.1), (14, 9)))
    start, goal = np.array([12.0, 2.0]), np.array([16.0, 2.0])
    way = grid_way(plan, drivable_cells(plan, 0.5), start, goal)
    assert np.abs(way - [14, 9]).max() < 1.5
    # The way goes round the end of the wall at 0.5 m: two tangents and an arc, within a cell.
    tangent = np.sqrt(1.9**2 + 7.1**2 - 0.5**2)
    length = np.hypot(*np.diff(np.vstack([start, way, goal]), axis=0).T).sum()
    assert 2 * tangent + 0.4 < length < 2 * tangent + 2.0
    drivable = drivable_cells(hall(lines((14, 0.1), (14, 15.9))), 0.5)
    assert grid_way(plan, drivable, np.array([12.0, 2.0]), np.array([16.0, 2.0])) is None


def test_sites_are_beside_the_route_and_keep_their_distances():
    plan = load_floor_plan("construction_hall")
    topology = grow_topology(plan)
    route, landmarks = initial_route(topology), find_landmarks(plan).positions
    sites = find_sites(plan, topology, route, landmarks)
    assert len(sites) == 24  # as many as in the paper
    number = KDTree(topology.nodes).query(sites)[1]
    on_route = set(route.tolist())
    beside = {int(b) for a in on_route for b in topology.neighbours(a)} - on_route
    behind = {int(b) for a in beside for b in topology.neighbours(a)} - on_route
    tree = KDTree(np.vstack([landmarks, sites]))
    gaps = tree.query(sites, 2)[0][:, 1]
    for site, gap in zip(number.tolist(), gaps, strict=True):
        assert site not in on_route
        assert (site in behind and gap >= 5) or (site in beside and gap >= 10)


def test_a_box_that_would_close_the_only_door_is_no_site():
    wall = np.concatenate([lines((22, 0.1), (22, 7.0)), lines((22, 9.0), (22, 15.9))])
    plan = hall(wall)
    topology = grow_topology(plan, TopologyConfig(spacing=1.2))
    sites = find_sites(plan, topology, initial_route(topology), np.zeros((0, 2)), SiteConfig(spacing=1.0, near=1.0))
    assert len(sites) > 20
    assert np.hypot(*(sites - [22, 8]).T).min() > 0.8


def test_a_plan_without_a_place_for_a_landmark_is_refused():
    plan = hall()
    topology = grow_topology(plan)
    landmarks = topology.nodes
    with pytest.raises(PlanError, match="no place for a landmark"):
        find_sites(plan, topology, initial_route(topology), landmarks)
