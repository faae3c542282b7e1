"""Features of grounds whose slopes, steps and roughness are known."""

import numpy as np
import open3d as o3d
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.traversability import (
    Ability,
    FuzzyTraversability,
    TerrainConfig,
    TerrainFeatures,
    describe_terrain,
    make_risk_map,
)
from naraha.systems.traversability.feature_kernels import slopes
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue

from tests.traversability.grounds import ground, plane, pole, step

AHEAD = 4


def paper_slopes(a, b, theta):
    norm = np.sqrt(a * a + b * b + 1)
    pitch = abs(np.arccos((-a * np.cos(theta) - b * np.sin(theta)) / norm) - np.pi / 2)
    return pitch, abs(np.arccos((a * np.sin(theta) - b * np.cos(theta)) / norm) - np.pi / 2)


@given(st.floats(-2, 2), st.floats(-2, 2), st.floats(-np.pi, np.pi))
def test_slopes_are_equations_2_and_3(a, b, theta):
    np.testing.assert_allclose(slopes(a, b, theta), paper_slopes(a, b, theta), atol=1e-12)


@pytest.mark.parametrize("fit", ["robust", "least_squares"])
@pytest.mark.parametrize(("slope", "towards"), [(0, 0), (10, 0), (15, 90), (25, 40), (35, 180)])
def test_the_slopes_of_a_plane_are_found_in_every_direction(fit, slope, towards):
    table = describe_terrain(ground(plane(slope, towards)), TerrainConfig(fit=fit))
    relative = np.deg2rad(towards) - table.directions
    along = np.arctan(np.tan(np.deg2rad(slope)) * np.cos(relative))
    np.testing.assert_allclose(
        np.sin(table.pitch_slope), np.abs(np.sin(np.deg2rad(slope)) * np.cos(relative)), atol=0.02
    )
    np.testing.assert_allclose(
        np.sin(table.roll_slope), np.abs(np.sin(np.deg2rad(slope)) * np.sin(relative)), atol=0.02
    )
    np.testing.assert_allclose(table.mean_height, 0.8 * np.tan(along), atol=0.02)
    assert table.coverage.min() == 1.0
    assert table.step_height.max() < 0.05


def test_least_squares_is_equation_1_and_4_to_6_over_the_points():
    points = ground(lambda x, y: 0.2 * x - 0.1 * y + 0.05 * np.sin(9 * x))
    table = describe_terrain(points, TerrainConfig(fit="least_squares", rectangles=1, start=0.0))
    x, y, z = points[(points[:, 0] >= 0) & (points[:, 0] <= 1) & (np.abs(points[:, 1]) <= 0.25)].astype(float).T
    A = np.column_stack([x, y, np.ones_like(x)])
    a, b, c = np.linalg.lstsq(A, z, rcond=None)[0]
    distance = np.abs(A @ [a, b, c] - z) / np.sqrt(a * a + b * b + 1)
    np.testing.assert_allclose(table.planes[0], [a, b, c], atol=1e-6)
    assert table.count[0] == len(x)
    assert table.roughness[0] == pytest.approx(distance.var(), rel=1e-4)
    assert table.mean_height[0] == pytest.approx(z.mean(), abs=1e-6)


def test_outliers_break_least_squares_and_not_the_robust_fit():
    # One-sided, as mirror images and dust are, and at one end: they tilt what they can.
    points = ground(plane(8))
    rng = np.random.default_rng(3)
    wrong = (points[:, 0] > 0.9) & (rng.uniform(size=len(points)) < 0.3)
    points[wrong, 2] += rng.uniform(0.2, 0.9, wrong.sum()).astype(np.float32)
    errors = {}
    for fit in ("robust", "least_squares"):
        table = describe_terrain(points, TerrainConfig(fit=fit))
        errors[fit] = abs(np.rad2deg(table.pitch_slope[AHEAD]) - 8)
    assert errors["robust"] < 1.0
    assert errors["least_squares"] > 5.0


@pytest.mark.parametrize("height", [0.05, 0.1, 0.17, 0.3, -0.2])
def test_steps_up_and_down_are_found_where_they_are(height):
    table = describe_terrain(ground(step(height)))
    assert table.step_height[AHEAD] == pytest.approx(abs(height), abs=0.04)
    assert table.step_height[[0, -1]].max() < 0.04


def test_a_thin_pole_is_a_step_and_stray_points_are_none():
    points = ground(plane(0))
    assert describe_terrain(np.vstack([points, pole((0.9, 0.0))])).step_height[AHEAD] > 0.3
    rng = np.random.default_rng(5)
    stray = np.column_stack([rng.uniform(0.4, 1.2, 12), np.linspace(-0.2, 0.2, 12), rng.uniform(0.3, 0.9, 12)])
    assert describe_terrain(np.vstack([points, stray.astype(np.float32)])).step_height[AHEAD] < 0.05


def test_ground_that_was_not_seen_is_not_covered():
    points = ground(plane(0))
    table = describe_terrain(points[points[:, 1] > 0])
    assert table.coverage[0] < 0.05
    assert table.coverage[-1] > 0.95
    assert 0.3 < table.coverage[AHEAD] < 0.7
    assert np.isnan(table.pitch_slope[0])


def test_rough_ground_is_rough():
    table = describe_terrain(ground(lambda x, y: 0.05 * np.sign(np.sin(20 * x) * np.sin(20 * y))))
    assert table.roughness.min() > 20 * describe_terrain(ground(plane(0))).roughness.max()


WALL = np.column_stack([np.full(500, 0.9), *np.random.default_rng(0).uniform([-1, 0], [1, 1], (500, 2)).T])


@pytest.mark.parametrize("fit", ["robust", "least_squares"])
@pytest.mark.parametrize(
    "points",
    [np.zeros((0, 3)), np.array([[0.8, 0, 0]]), np.full((100, 3), np.nan), np.full((100, 3), 50.0), WALL],
    ids=["empty", "one point", "not finite", "far away", "nothing but a wall"],
)
def test_too_little_to_judge_is_never_traversable(points, fit):
    table = describe_terrain(points, TerrainConfig(fit=fit))
    ability = Ability()
    system = FuzzyTraversability(ability)
    context = system.CreateDefaultContext()
    system.GetInputPort("features").FixValue(context, AbstractValue.Make(table))
    risk = 1 / system.GetOutputPort("traversability").Eval(context)
    seen = table.coverage >= ability.min_coverage
    assert not (seen & (risk < ability.risk_limit) & (table.step_height < ability.step_threshold)).any()


@pytest.mark.parametrize(("key", "value"), [("width", 0.0), ("depth", 0.0), ("rectangles", 0), ("fit", "ransac")])
def test_rectangles_that_are_none_are_refused(key, value):
    with pytest.raises(ConfigError, match=rf"terrain: {key}"):
        TerrainFeatures(TerrainConfig(**{key: value}))


def test_the_system_says_what_the_function_does():
    points = ground(plane(12))
    system = TerrainFeatures()
    context = system.CreateDefaultContext()
    with pytest.raises(PortError, match=r"TerrainFeatures\.cloud_H"):
        system.GetOutputPort("features").Eval(context)
    system.GetInputPort("cloud_H").FixValue(context, AbstractValue.Make(PointCloud(points)))
    table = system.GetOutputPort("features").Eval(context)
    np.testing.assert_array_equal(table.inputs, describe_terrain(points).inputs)


def test_risers_of_a_recorded_staircase_are_found(shared_data):
    """Flat levels at 0.595, 0.765, 0.935, 1.105 and 1.285 m, risers at x = 2.50, 2.79, 3.08 and 3.37 m."""
    cloud = o3d.t.io.read_point_cloud(str(shared_data / "terrain_plane_seg" / "anymal_ori_stair_06.pcd"))
    points = cloud.point.positions.numpy()
    config = TerrainConfig(rectangles=1, start=0.3, depth=0.25, width=0.4)
    for riser, level, height in ((2.50, 0.595, 0.17), (2.79, 0.765, 0.17), (3.08, 0.935, 0.17), (3.37, 1.105, 0.18)):
        # A robot on the lower level, 0.42 m in front of the riser.
        table = describe_terrain(points - np.float32([riser - 0.42, 0.7, level]), config)
        assert table.step_height[0] == pytest.approx(height, abs=0.04)
    # All of the stair at once: it rises by 4 × 0.17 m in 1.1 m, and no step is higher than a riser.
    whole = describe_terrain(points - np.float32([2.1, 0.7, 0.595]), TerrainConfig(rectangles=1, depth=1.1, width=0.4))
    assert whole.step_height[0] == pytest.approx(0.17, abs=0.04)
    assert np.rad2deg(whole.pitch_slope[0]) == pytest.approx(np.rad2deg(np.arctan(0.17 / 0.29)), abs=6)


def test_tilted_cinder_blocks_are_rough_and_the_floor_beside_them_is_not(shared_data):
    cloud = o3d.t.io.read_point_cloud(str(shared_data / "terrain_plane_seg" / "tilted-steps.pcd"))
    points = cloud.point.positions.numpy()
    points = points[np.isfinite(points).all(axis=1)]
    found = make_risk_map(points[points[:, 2] < 1.0], Ability())
    flat = np.abs(found.height) < 0.03
    blocks = (found.height > 0.1) & (found.height < 0.8)
    assert min(np.isfinite(found.step[flat]).sum(), np.isfinite(found.step[blocks]).sum()) > 100
    assert np.nanmedian(found.step[flat]) < 0.05
    assert np.nanpercentile(found.step[blocks], 75) > 0.1
