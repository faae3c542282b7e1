"""LiDAR shots at the floor: which count, where, and what a drive past water leaves of them."""

import numpy as np
import open3d as o3d
import pytest
from naraha.systems.errors import PortError
from naraha.systems.hazards.lidar_water import (
    RayMemory,
    floor_height,
    local_floor_height,
    ray_distances,
    shots_at_floor,
)
from naraha.systems.hazards.shot_grid import BLOCKED, HIT, MIRROR, MISSING, ShotConfig, ShotGrid
from naraha.systems.sensing import Scan
from naraha.systems.sensing.lidar import sweep_rays
from open3d.t.geometry import PointCloud
from pydrake.geometry import Box

from tests.hazards.pool_hall import MAT, PATTERN, POOL, hall_scene, scan_between, sensor_pose
from tests.sensing.conftest import ShapeWorld

CONFIG = ShotConfig()
LEVEL = sensor_pose(0.0)


def plane_distances(X_MS0=LEVEL, X_MS1=LEVEL, z_floor=0.0):
    """Distance of every ray to an endless floor, and where it meets it; NaN for rays that do not."""
    p, d = (a.astype(float) for a in sweep_rays(PATTERN, X_MS0.GetAsMatrix4(), X_MS1.GetAsMatrix4()))
    with np.errstate(divide="ignore"):
        distance = np.where(d[:, 2] < 0, (z_floor - p[:, 2]) / d[:, 2], np.nan)
    return distance, p[:, :2] + distance[:, None] * d[:, :2]


def sort(distance, X_MS0=LEVEL, X_MS1=LEVEL, z_floor=0.0, **options):
    return shots_at_floor(
        PATTERN, distance.astype(np.float32), X_MS0.GetAsMatrix4(), X_MS1.GetAsMatrix4(), z_floor, CONFIG, **options
    )


def near(xy, place, radius):
    return np.hypot(*(xy - place).T) < radius


@pytest.fixture(scope="module", params=[True, False], ids=["mirror images", "nothing comes back"])
def driven(request):
    """The grid after driving past pool and mat, 1 to 4 m away."""
    scene = hall_scene(ShapeWorld())
    grid, memory = ShotGrid(CONFIG), RayMemory(0.0, np.full(PATTERN.rays, -np.inf, np.float32))
    step = 0.05
    for i, x in enumerate(np.arange(-0.8, 2.2, step)):
        X_MS0, X_MS1 = sensor_pose(x - step), sensor_pose(x)
        distance = ray_distances(scan_between(scene, X_MS0, X_MS1, i, mirror=request.param), PATTERN)
        memory = memory.after(distance, step)
        grid = grid.add(sort(distance, X_MS0, X_MS1, hidden=memory.hidden(CONFIG)))
    return grid


def test_the_pool_is_told_from_black_rubber_and_from_the_floor(driven):
    xy = np.stack(np.meshgrid(np.arange(0.5, 6, 0.1), np.arange(-3, 3, 0.1), indexing="ij"), -1).reshape(-1, 2) + 0.05
    ratio = driven.log_likelihood_ratio(xy)
    pool, mat = near(xy, POOL, 0.33), np.abs(xy - MAT).max(axis=1) < 0.35
    assert ratio[pool].min() > 2
    assert ratio[mat].max() < -2
    floor = ~near(xy, POOL, 0.5) & (xy[:, 0] > 1.5) & (xy[:, 0] < 3.8)
    assert (ratio[floor] < -2).mean() > 0.98
    assert ratio[floor].max() <= 0


def test_where_no_shot_went_nothing_is_said(driven):
    behind_the_panel = np.stack(np.meshgrid([5.05, 5.15, 5.25], [-0.05, 0.05], indexing="ij"), -1).reshape(-1, 2)
    assert driven.counts(behind_the_panel)[:, BLOCKED].sum() > 50
    np.testing.assert_array_equal(driven.log_likelihood_ratio(behind_the_panel), 0)
    np.testing.assert_array_equal(driven.log_likelihood_ratio([[50, 50], [np.nan, 0], [-1e30, 0]]), 0)


def test_every_shot_at_the_floor_is_a_hit_where_it_was_measured():
    distance, xy = plane_distances()
    shots = sort(distance)
    assert (shots.kind == HIT).all()
    within = (distance <= CONFIG.max_range) & (distance > 0)
    np.testing.assert_allclose(shots.xy_M, xy[within], atol=1e-4)
    assert (shots.evidence <= 0).all()


def test_a_hole_in_the_returns_is_missing_at_its_place_even_when_the_robot_errs_about_the_floor():
    distance, xy = plane_distances()
    pool = near(xy, (2.4, 0.3), 0.4)
    distance[pool] = np.nan
    for z_floor in (0.0, 0.1, -0.1):
        shots = sort(distance, z_floor=z_floor)
        found = shots.kind == MISSING
        assert found.sum() == pool.sum() > 50
        assert (np.hypot(*(shots.xy_M[found] - [2.4, 0.3]).T) < 0.41).all()
        assert (shots.evidence[found] >= 0).all()


def test_a_return_from_below_the_floor_is_a_mirror_image():
    distance, xy = plane_distances()
    pool = near(xy, (2.4, 0.3), 0.4)
    distance[pool] *= 2
    shots = sort(distance)
    mirror = shots.kind == MIRROR
    assert mirror.sum() == pool.sum()
    assert (np.hypot(*(shots.xy_M[mirror] - [2.4, 0.3]).T) < 0.41).all()
    grid = ShotGrid(CONFIG).add(shots)
    assert grid.log_likelihood_ratio(shots.xy_M[mirror]).max() > 2


def test_a_gap_next_to_something_nearer_says_nothing():
    distance, xy = plane_distances()
    gap = near(xy, (2.4, 0.3), 0.4)
    distance[gap] = np.nan
    distance[near(xy, (2.4, 0.9), 0.5) & ~gap] *= 0.5
    shots = sort(distance)
    assert (shots.kind == BLOCKED).sum() == (near(xy, (2.4, 0.9), 0.5) & ~gap).sum()
    assert (shots.kind == MISSING).sum() == 0


def test_a_gap_that_is_too_wide_says_nothing():
    distance, xy = plane_distances()
    distance[xy[:, 0] > 0.3] = np.nan
    assert (sort(distance).kind == HIT).all()


def test_rays_that_the_robot_hides_from_itself_do_not_count():
    scene = hall_scene(ShapeWorld())
    own = np.full(PATTERN.rays, np.inf, np.float32)
    own[np.abs(PATTERN.azimuths[PATTERN.column] - 0.9) < 0.1] = 0.15  # a post beside the sensor
    memory = RayMemory(0.0, np.full(PATTERN.rays, -np.inf, np.float32))
    with_mask, without = ShotGrid(CONFIG), ShotGrid(CONFIG)
    for i in range(12):
        X_MS0, X_MS1 = sensor_pose(0.1 * i - 0.1), sensor_pose(0.1 * i)
        distance = ray_distances(scan_between(scene, X_MS0, X_MS1, i, own_distance=own), PATTERN)
        memory = memory.after(distance, 0.1)
        with_mask = with_mask.add(sort(distance, X_MS0, X_MS1, hidden=memory.hidden(CONFIG)))
        without = without.add(sort(distance, X_MS0, X_MS1))
    _, xy = plane_distances(sensor_pose(1.1), sensor_pose(1.1))
    hidden = (own < 1) & (np.linalg.norm(xy - [1.1, 0], axis=1) < 2.2) & ~near(xy, POOL, 0.6)
    assert (without.log_likelihood_ratio(xy[hidden]) > 0).any()
    assert (with_mask.log_likelihood_ratio(xy[hidden]) <= 0).all()
    assert memory.hidden(CONFIG)[own < 1].all()


def test_the_memory_of_a_ray_lasts_as_long_as_it_is_told():
    memory = RayMemory(0.0, np.full(3, -np.inf, np.float32))
    memory = memory.after(np.array([1.0, np.nan, np.nan]), 0.0)
    np.testing.assert_array_equal(memory.hidden(CONFIG), [False, True, True])
    memory = memory.after(np.array([np.nan, 1.0, np.nan]), 2.0)
    np.testing.assert_array_equal(memory.hidden(CONFIG), [False, False, True])
    memory = memory.after(np.full(3, np.nan), 2.0)
    np.testing.assert_array_equal(memory.hidden(CONFIG), [True, False, True])


def test_the_floor_is_the_lowest_strong_level():
    rng = np.random.default_rng(0)

    def layer(z, count):
        return np.column_stack([rng.uniform(-3, 3, (count, 2)), rng.normal(z, 0.01, count)])

    ceiling, table, floor, stray = layer(2.5, 4000), layer(0.7, 500), layer(0.13, 3000), layer(-0.6, 50)
    points = np.vstack([ceiling, table, floor, stray])
    assert floor_height(points) == pytest.approx(0.13, abs=0.01)
    assert floor_height(points, near=0.6, search=0.3) == pytest.approx(0.7, abs=0.01)
    wall = np.column_stack([np.zeros((9000, 2)), rng.uniform(-2, 3, 9000)])
    both, tilt = np.vstack([points, wall]), np.r_[np.zeros(len(points)), np.full(9000, np.pi / 2)]
    assert floor_height(both, tilt) == pytest.approx(0.13, abs=0.01)


def test_without_points_there_is_no_floor():
    assert np.isnan(floor_height(np.zeros((0, 3))))
    assert np.isnan(floor_height(np.full((5, 3), np.nan)))
    assert np.isnan(floor_height(np.zeros((5, 3)), near=9.0))
    assert floor_height(np.array([[0, 0, 1.5]])) == pytest.approx(1.5)
    assert floor_height(np.array([[0, 0, 0.2]] * 9 + [[0, 0, 1e12]])) == pytest.approx(0.2)


@pytest.mark.parametrize("bad", ["nan pose", "no returns", "one return", "high up", "upside down"])
def test_a_scan_that_cannot_be_used_gives_no_shots(bad):
    distance, _ = plane_distances()
    X_MS = LEVEL.GetAsMatrix4().copy()
    if bad == "nan pose":
        X_MS[0, 3] = np.nan
    elif bad == "no returns":
        distance[:] = np.nan
    elif bad == "one return":
        distance[1:] = np.nan
    elif bad == "high up":
        X_MS[2, 3] = 100.0
    else:
        X_MS[:3, :3] = np.diag([1, -1, -1])
    shots = shots_at_floor(PATTERN, distance.astype(np.float32), X_MS, X_MS, 0.0, CONFIG)
    assert len(shots.kind) == 0
    assert ShotGrid().add(shots).tiles == {}


def test_distances_are_those_of_the_rays_they_belong_to():
    scene = hall_scene(ShapeWorld(), extra=[(Box(1, 1, 1), (-1.5, 0, 0.5), "crate")])
    scan = scan_between(scene, LEVEL, LEVEL)
    distance = ray_distances(scan, PATTERN)
    np.testing.assert_allclose(
        (PATTERN.p_SR + distance[:, None] * PATTERN.d_S)[np.isfinite(distance)], scan.p_SP, atol=1e-5
    )
    assert np.isfinite(distance).sum() == len(scan.p_SP)


def test_a_scan_of_another_lidar_is_refused_and_one_without_rings_is_not_used():
    cloud = PointCloud(o3d.core.Tensor(np.ones((2, 3), np.float32)))
    assert ray_distances(Scan(cloud, 0.0, 0.1, 0), PATTERN) is None
    cloud.point["ring"] = o3d.core.Tensor(np.array([[0], [16]], np.uint8))
    cloud.point["column"] = o3d.core.Tensor(np.array([[0], [3]], np.uint16))
    with pytest.raises(PortError, match="16 rings"):
        ray_distances(Scan(cloud, 0.0, 0.1, 0), PATTERN)


def test_a_pitch_that_is_wrong_by_a_degree_does_not_make_water():
    X = sensor_pose(0.0, pitch=np.radians(1))
    distance, _ = plane_distances(X, X)
    shots = sort(distance)  # the robot believes that it is level
    assert (shots.kind == HIT).sum() > 5000
    assert np.isin(shots.kind, (MISSING, MIRROR)).sum() == 0


def test_the_floor_of_a_bent_map_is_found_where_it_is():
    rng = np.random.default_rng(0)
    xy = rng.uniform([0, 0], [12, 6], (6000, 2))
    bent = 0.01 * xy[:, 0]  # 0.12 m over 12 m
    floor = np.column_stack([xy, bent + rng.normal(0, 0.01, len(xy))])
    table = np.column_stack([rng.uniform([4, 2], [5, 3], (300, 2)), np.full(300, 0.8)])
    points = np.vstack([floor, table, [[np.nan, 0, 0], [40.0, 40.0, 0.0]]])
    found = local_floor_height(points, np.zeros(len(points)), 0.05)
    assert np.abs(found[:6000] - bent).max() < 0.03
    assert np.abs(found[6000:6300] - 0.045).max() < 0.03
    assert found[-2] == found[-1] == 0.05
    np.testing.assert_array_equal(local_floor_height(points, None, np.nan), np.full(len(points), np.nan))
