"""From a semantic map to voxels and to the grid of cells that can be entered."""

from pathlib import Path

import naraha.models
import numpy as np
import open3d as o3d
import pytest
from naraha.systems.errors import ConfigError, InputError, PortError
from naraha.systems.routes import (
    DOSE,
    FENCE,
    FREE,
    HOT,
    OCCUPIED,
    UNKNOWN,
    WATER,
    RouteGrid,
    VoxelWorld,
    VoxelWorldConfig,
    find_routes,
    make_route_grid,
    make_voxels,
)
from naraha.systems.slam import Keyframe
from naraha.systems.traversability import Ability, read_ability
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator

from .route_examples import floor_with_pool

CRAWLER = Path(naraha.models.__file__).parent / "crawler" / "ability.yaml"


def cloud_of(points, **attributes):
    cloud = PointCloud(o3d.core.Tensor(np.asarray(points, np.float32)))
    for name, values in attributes.items():
        cloud.point[name] = o3d.core.Tensor(np.ascontiguousarray(values).reshape(-1, 1))
    return cloud


def patch(x0, x1, y0, y1, z=0.0, spacing=0.04):
    x, y = np.meshgrid(np.arange(x0, x1, spacing), np.arange(y0, y1, spacing), indexing="ij")
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, z)])


def kind_at(grid, x, y):
    return grid.kind[tuple(grid.index_of(np.array([x, y])))]


@pytest.fixture(scope="module")
def crawler():
    return read_ability(CRAWLER)


@pytest.mark.parametrize("knows", [False, True])
def test_walls_and_water_close_cells_and_grow_by_the_robot(knows, crawler):
    grid = make_route_grid(floor_with_pool(), crawler if knows else None)
    half_diagonal = 0.5 * np.hypot(*(crawler if knows else Ability()).footprint) + 0.05
    assert kind_at(grid, 2.5, 1.5) == FREE
    assert kind_at(grid, 0.0, 0.0) == WATER
    assert kind_at(grid, 0.4 + half_diagonal - 0.1, 0.0) == WATER
    assert kind_at(grid, 0.4 + half_diagonal + 0.15, 0.0) == FREE
    assert kind_at(grid, 2.0, 3.0 - half_diagonal + 0.1) in (OCCUPIED, FENCE)
    assert kind_at(grid, 2.0, 3.0 - half_diagonal - 0.25) == FREE


def test_water_keeps_the_whole_robot_away_where_obstacles_keep_off_less(crawler):
    grid = make_route_grid(floor_with_pool(), crawler, VoxelWorldConfig(growth=0.3))
    half_diagonal = 0.5 * np.hypot(*crawler.footprint) + 0.05
    assert kind_at(grid, 0.4 + half_diagonal - 0.1, 0.0) == WATER
    assert kind_at(grid, 2.0, 3.0 - half_diagonal) == FREE
    assert kind_at(grid, 2.0, 3.0 - 0.25) in (OCCUPIED, FENCE)


def test_routes_lead_past_the_pool_on_both_sides(crawler):
    grid = make_route_grid(floor_with_pool(), crawler)
    routes = find_routes(grid, np.array([-3, 0, 0]), np.array([3, 0]))
    assert {route.sides for route in routes} == {("left of water",), ("right of water",)}


def test_a_stair_is_a_way_for_the_crawler_and_a_wall_on_a_flat_floor(crawler):
    ground = [patch(-5, 0, -2, 2, spacing=0.03)]
    for step in range(5):
        low, high = 0.26 * step, 0.26 * (step + 1) if step < 4 else 4.0
        ground.append(patch(low, high, -2, 2, 0.18 * (step + 1), 0.03))
    cloud = cloud_of(np.vstack(ground))
    start, goal = np.array([-2, 0, 0]), np.array([3, 0])
    (route,) = find_routes(make_route_grid(cloud, crawler), start, goal)
    assert route.steepest_rad == pytest.approx(np.arctan2(0.18, 0.26), abs=0.12)
    assert route.tilt_rad < 0.1
    assert route.z[-1] - route.z[0] == pytest.approx(0.9, abs=0.05)
    flat = make_route_grid(cloud)
    with pytest.raises(InputError, match="goal"):
        find_routes(flat, start, goal)


def test_a_stair_as_narrow_as_the_mock_up_and_its_landing_are_climbed_along_the_middle(crawler):
    """Six steps up to a landing 1.2 m wide that ends in a wall of air: up and back down the other side."""
    treads = [(0.26 * step, 0.18 * (step + 1)) for step in range(5)]
    solid = [patch(x, x + 0.26, -0.6, 0.6, z, 0.03) for x, z in treads]
    solid += [patch(4.2 - x - 0.26, 4.2 - x, -0.6, 0.6, z, 0.03) for x, z in treads]
    solid += [patch(1.3, 2.9, -0.6, 0.6, 1.08, 0.03)]
    floor = patch(-4, 8, -3, 3, 0.0, 0.05)
    floor = floor[~((floor[:, 0] > 0) & (floor[:, 0] < 4.2) & (np.abs(floor[:, 1]) < 0.6))]
    grid = make_route_grid(cloud_of(np.vstack([floor, *solid])), crawler)
    routes = find_routes(grid, np.array([-2, 0, 0]), np.array([6, 0]))
    (over,) = [route for route in routes if np.nanmax(route.z) > 0.9]
    assert over.tilt_rad < 0.15
    assert np.abs(over.xy[(over.xy[:, 0] > 0.2) & (over.xy[:, 0] < 4), 1]).max() < 0.2
    assert len(routes) == 3
    # Beside the stair the robot may turn, so it keeps half its diagonal from the steps.
    assert kind_at(grid, 2.0, 1.1) == OCCUPIED
    assert kind_at(grid, 2.0, 1.65) == FREE


def test_a_drop_and_a_high_step_are_no_way(crawler):
    cloud = cloud_of(np.vstack([patch(-3, 0, -2, 2), patch(0, 3, -2, 2, -0.5)]))
    grid = make_route_grid(cloud, crawler)
    assert find_routes(grid, np.array([-2, 0, 0]), np.array([2, 0])) == ()


def test_what_hangs_over_the_robot_is_no_obstacle(crawler):
    beam = patch(-0.2, 0.2, -2, 2, 1.8)
    grid = make_route_grid(cloud_of(np.vstack([patch(-3, 3, -2, 2), beam])), crawler)
    assert find_routes(grid, np.array([-2, 0, 0]), np.array([2, 0]))


def test_heat_and_dose_close_cells_where_they_are_near_the_ground():
    floor = patch(-3, 3, -2, 2)
    pipe = patch(-1.1, -0.9, -0.1, 0.1, 0.3)
    high_pipe = patch(1.0, 1.2, -0.1, 0.1, 1.5)
    points = np.vstack([floor, pipe, high_pipe])
    label = np.r_[np.zeros(len(floor)), np.full(len(pipe) + len(high_pipe), 2)].astype(np.uint8)
    dose = np.where(points[:, 1] > 1.2, 5000.0, 100.0).astype(np.float32)
    grid = make_route_grid(cloud_of(points, label=label, dose_rate=dose))
    assert kind_at(grid, -1.0, 0.0) == HOT
    assert kind_at(grid, 1.1, 0.0) == FREE
    assert kind_at(grid, 0.0, 1.5) == DOSE
    assert kind_at(grid, 0.0, 1.0) == FREE
    at = tuple(grid.index_of(np.array([0.0, -1.0])))
    assert grid.dose_rate[at] == pytest.approx(100)
    assert grid.cost[at] == pytest.approx(1 + 4 * 0.1, rel=1e-3)


def test_thin_data_is_fenced_and_small_gaps_are_bridged():
    floor = patch(-3, 3, -2, 2)
    hole = (np.abs(floor[:, 0] - 1.5) < 0.6) & (np.abs(floor[:, 1]) < 0.6)
    slit = np.abs(floor[:, 0] + 1.5) < 0.09
    grid = make_route_grid(cloud_of(floor[~hole & ~slit]), config=VoxelWorldConfig(max_gap=0.3))
    assert kind_at(grid, 1.5, 0.0) == UNKNOWN
    assert kind_at(grid, 1.5, 0.65) == FENCE
    assert kind_at(grid, -1.5, 0.0) == FREE
    assert kind_at(grid, 0.0, 0.0) == FREE
    at_slit, beside = (grid.cost[tuple(grid.index_of(np.array([x, 0.0])))] for x in (-1.5, -0.5))
    assert at_slit > beside == 1


def test_ground_below_the_sensors_is_taken_for_ground_only_where_the_robot_stood():
    floor = patch(-3, 3, -2.5, 2.5)
    blind = np.hypot(*floor[:, :2].T) < 1.0
    cloud = cloud_of(floor[~blind])
    assert kind_at(make_route_grid(cloud), 0.0, 0.0) == UNKNOWN
    assert kind_at(make_route_grid(cloud, stood=np.zeros((1, 2))), 0.0, 0.0) == FREE


def gap_in_a_wall(width, *more):
    wall = [patch(-0.1, 0.1, a, b, z) for a, b in ((-2, -width / 2), (width / 2, 2)) for z in np.arange(0.1, 1.0, 0.1)]
    return cloud_of(np.vstack([patch(-3, 3, -2, 2), *wall, *more]))


def test_where_the_robot_has_come_through_it_comes_through_again():
    start, goal, through = np.array([-2.0, 0, 0]), np.array([2.0, 0]), np.array([[-1, 0], [0, 0], [1, 0]])
    narrow = gap_in_a_wall(0.9)
    assert find_routes(make_route_grid(narrow), start, goal) == ()
    assert find_routes(make_route_grid(narrow, stood=through[[0, 0, 0]]), start, goal) == ()
    (route,) = find_routes(make_route_grid(narrow, stood=through), start, goal)
    assert np.abs(route.xy[np.abs(route.xy[:, 0]) < 0.5, 1]).max() < 0.2
    # Not where it is not known how it has come, and not where something now stands in it.
    assert find_routes(make_route_grid(narrow, stood=2.2 * through), start, goal) == ()
    fallen = gap_in_a_wall(0.9, patch(-0.1, 0.1, -0.1, 0.1, 0.3))
    assert find_routes(make_route_grid(fallen, stood=through), start, goal) == ()


def test_stray_points_far_away_do_not_make_the_grid_large():
    floor = patch(-3, 3, -2, 2)
    stray = np.array([[60.0, 40.0, -3.0]])
    plain, strayed = (make_route_grid(cloud_of(points), Ability()) for points in (floor, np.vstack([floor, stray])))
    np.testing.assert_allclose(strayed.shape, plain.shape, atol=2)


def test_voxels_are_what_their_points_are():
    floor, wall = patch(-1, 1, -1, 1), np.array([[0.95, y, z] for y in np.arange(-1, 1, 0.05) for z in (0.5, 0.8)])
    water, hot = np.array([[0.05, 0.05, 0.02]]), np.array([[0.95, 0.05, 1.05]])
    points = np.vstack([floor, wall, water, hot])
    label = np.r_[np.zeros(len(floor) + len(wall)), 1, 2].astype(np.uint8)
    grid = RouteGrid.from_kind(np.zeros((20, 20), np.uint8), 0.1, (-1, -1))
    voxels = make_voxels(cloud_of(points, label=label), grid, voxel=0.1, max_dose_rate=1000, step=0.1)
    found = dict(zip(map(tuple, voxels.index.tolist()), voxels.kind.tolist(), strict=True))
    assert found[0, 0, 0] == WATER
    assert found[9, 0, 10] == HOT
    assert found[-5, -5, 0] == FREE
    assert found[9, -5, 5] == OCCUPIED
    assert len(found) == 400 + 2 * 20 + 1
    assert np.abs(voxels.centres[:, 2] - 0.05).min() < 1e-9


def keyframe(index, x, cloud):
    return Keyframe(index, 0.0, RigidTransform([x, 0, 0.2]), None, cloud, 0.0)


def test_the_grid_is_made_anew_when_a_keyframe_came_and_stays_the_object_it_was_otherwise():
    system, cloud = VoxelWorld(VoxelWorldConfig(period=0.5)), floor_with_pool()
    simulator = Simulator(system)
    context = simulator.get_mutable_context()

    def give(map_M, keyframes):
        system.GetInputPort("semantic_M").FixValue(context, AbstractValue.Make(map_M))
        system.GetInputPort("keyframes").FixValue(context, AbstractValue.Make(keyframes))
        simulator.AdvanceTo(context.get_time() + 0.5)
        return system.GetOutputPort("route_grid").Eval(context)

    nothing = give(PointCloud(), ())
    assert nothing.shape == (1, 1)
    assert nothing.kind[0, 0] == UNKNOWN
    first = give(cloud, (keyframe(0, -3, cloud),))
    assert kind_at(first, 0.0, 0.0) == WATER
    assert len(system.GetOutputPort("voxels").Eval(context).index) > 1000
    assert give(cloud_of(patch(-1, 1, -1, 1)), (keyframe(0, -3, cloud),)) is first
    assert give(cloud, (keyframe(0, -3, cloud), keyframe(1, -2.9, cloud))) is first
    other = give(cloud_of(patch(-1, 1, -1, 1)), (keyframe(0, -3, cloud), keyframe(1, 0, cloud)))
    assert other.shape != first.shape


def test_what_cannot_be_used_is_refused():
    with pytest.raises(InputError, match="no point"):
        make_route_grid(PointCloud())
    with pytest.raises(ConfigError, match=r"voxel_world\.voxel"):
        VoxelWorld(VoxelWorldConfig(voxel=0))
    with pytest.raises(ConfigError, match="step_threshold"):
        VoxelWorld(ability=Ability(step_threshold=-1))
    system = VoxelWorld()
    simulator = Simulator(system)
    system.GetInputPort("keyframes").FixValue(simulator.get_mutable_context(), AbstractValue.Make([]))
    with pytest.raises(PortError, match=r"VoxelWorld\.keyframes"):
        simulator.AdvanceTo(0.1)
