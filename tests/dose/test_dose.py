"""Sources and dose field from simulated counts, against what is on paper and against the shipped hall."""

import numpy as np
import pytest
from naraha.models.worlds import load_world
from naraha.models.worlds.stair_hall import FREE_WAY
from naraha.systems.dose.dose_estimate import DoseConfig, estimate_dose
from naraha.systems.dose.dose_field import DoseReadings
from naraha.systems.dose.voxel_shadow import VoxelShadow
from naraha.systems.errors import ConfigError, InputError
from naraha.systems.sensing import RayScene, welded_frames
from naraha.systems.sensing.gamma_counter import GAMMA_CS137, counts_from_uniform, source_dose_rate
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

PERIOD, BACKGROUND, SENSITIVITY, DEAD_TIME = 0.5, 0.1, 1000.0, 5e-6
TOUR = FREE_WAY.tolist()
ROUND = [(-4, -3), (4, -3), (4, 3), (-4, 3), (-4, -3)]


def along(corners, step=0.15, height=0.5):
    """Places on the way of a robot with 0.3 m/s that counts for half a second at a time."""
    corners = np.asarray(corners, float)
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = np.arange(step / 2, length[-1], step)
    return np.column_stack([np.interp(at, length, corners[:, i]) for i in range(2)] + [np.full(len(at), height)])


def count(rate, p_MG, seed=0):
    """Readings at dose rates (N,) [uSv/h]."""
    uniform = np.random.default_rng(seed).random(len(rate))
    draws = zip(uniform, rate, strict=True)
    counts = np.array([counts_from_uniform(u, SENSITIVITY * r, PERIOD, DEAD_TIME) for u, r in draws], int)
    return DoseReadings(PERIOD * np.arange(len(rate)), counts, PERIOD - DEAD_TIME * counts, p_MG)


def open_air(p_MP, sources, depth=0.0):
    """Dose rate [uSv/h] of sources (x, y, z, MBq) behind nothing, or each behind a depth."""
    rate = np.full(len(p_MP), BACKGROUND)
    for *place, activity in sources:
        rate += source_dose_rate(activity, np.linalg.norm(p_MP - place, axis=1), depth)
    return rate


def surveyed(sources, way=ROUND, seed=0, **config):
    p_MG = along(way)
    return estimate_dose(count(open_air(p_MG, sources), p_MG, seed), DoseConfig(**config))


def wall_points(rng, low, high, count):
    """Points on the faces of an upright box, as a LiDAR gives them."""
    low, high = np.array(low, float), np.array(high, float)
    points = rng.uniform(low, high, (count, 3))
    side = rng.integers(0, 4, count)
    points[side == 0, 0], points[side == 1, 0] = low[0], high[0]
    points[side == 2, 1], points[side == 3, 1] = low[1], high[1]
    return points


# --- sources in the open ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("place", [(1.5, 0.7, 0.2), (6.0, 1.0, 0.3), (-5.5, -4.5, 0.1), (4.1, 0.0, 0.3)])
def test_one_source_is_found_with_its_activity(place):
    dose = surveyed([(*place, 30.0)])
    (source,) = dose.sources
    assert np.linalg.norm(source.p_M[:2] - place[:2]) < 0.25
    assert source.activity_mbq == pytest.approx(30, abs=max(4 * source.activity_sigma, 3))
    assert source.dose_rate_1m == pytest.approx(GAMMA_CS137 * source.activity_mbq)
    assert source.probability > 0.95
    assert dose.background == pytest.approx(BACKGROUND, abs=0.01)
    assert dose.health.state == "good"


@pytest.mark.slow
def test_errors_of_the_position_are_as_large_as_the_covariance_says():
    """The normalised squared error in plan has 2 degrees of freedom: a mean of 2 ± 0.4 over 24 seeds."""
    errors = []
    for seed in range(24):
        (source,) = surveyed([(0.8, 0.6, 0.3, 10.0)], seed=seed).sources
        away = source.p_M[:2] - [0.8, 0.6]
        errors.append(away @ np.linalg.solve(source.covariance[:2, :2], away))
    assert 0.5 < np.mean(errors) < 3.5


def test_two_sources_are_told_apart():
    truth = np.array([(2.0, 0.5, 0.2, 40.0), (-5.2, 0.0, 0.3, 20.0)])
    dose = surveyed(truth)
    assert len(dose.sources) == 2
    found = np.array([source.p_M for source in dose.sources])
    assert np.linalg.norm(found[:, :2] - truth[:, :2], axis=1).max() < 0.3
    np.testing.assert_allclose([source.activity_mbq for source in dose.sources], [40, 20], rtol=0.15)


def test_no_more_sources_than_allowed_are_reported():
    dose = surveyed([(2.0, 0.5, 0.2, 40.0), (-5.2, 0.0, 0.3, 20.0)], max_sources=1)
    assert len(dose.sources) == 1
    assert surveyed([(2.0, 0.5, 0.2, 40.0)], max_sources=0).sources == ()


@pytest.mark.parametrize("seed", range(6))
def test_background_alone_gives_no_source(seed):
    dose = surveyed([], seed=seed)
    assert dose.sources == ()
    assert dose.background == pytest.approx(BACKGROUND, abs=5 * dose.background_sigma)
    assert 0 < dose.background_sigma < 0.01
    assert dose.health.state == "good"


def test_straight_way_leaves_the_side_open_and_says_so():
    dose = surveyed([(0.0, 2.0, 0.5, 20.0)], way=[(-6, 0), (6, 0)])
    (source,) = dose.sources
    assert dose.health.state == "ambiguous"
    assert "or" in dose.health.reason
    assert 0.3 < source.probability < 0.7
    ((mirrored, strength, probability),) = source.alternatives
    np.testing.assert_allclose(mirrored[:2], source.p_M[:2] * [1, -1], atol=0.5)
    assert strength == pytest.approx(source.dose_rate_1m, rel=0.3)
    assert probability + source.probability == pytest.approx(1, abs=0.05)
    both = np.array([[0.0, 2.0, 0.5], [0.0, -2.0, 0.5]])
    credible = source.cells.p_MC[source.cells.credible()]
    assert all(np.linalg.norm(credible[:, :2] - place[:2], axis=1).min() < 0.4 for place in both)
    # The deviation of the field knows of the other side.
    side = np.array([[source.p_M[0], -np.sign(source.p_M[1]) * 2.5, 0.5]])
    truth_if_there = GAMMA_CS137 * 20 / 0.5**2
    assert dose.sigma(side)[0] > 0.3 * truth_if_there


def test_cell_probabilities_are_a_distribution_and_the_credible_region_holds_its_share():
    (source,) = surveyed([(1.5, 0.7, 0.2, 30.0)]).sources
    cells = source.cells
    assert cells.probability.sum() == pytest.approx(1)
    assert 0.95 <= cells.probability[cells.credible(0.95)].sum() < 1
    assert cells.size.prod(axis=1).sum() == pytest.approx(18 * 16 * 2.5, rel=0.02)  # reach 5 m, no map


def test_height_is_reported_as_what_it_is_worth():
    (source,) = surveyed([(6.5, 0.0, 1.2, 40.0)]).sources
    assert source.covariance[2, 2] ** 0.5 > 2 * source.covariance[1, 1] ** 0.5


# --- the field -------------------------------------------------------------------------------------------------------


def test_field_is_background_and_inverse_square_and_its_error_within_its_sigma():
    truth = [(1.0, 0.0, 0.2, 30.0)]
    dose = surveyed(truth)
    points = np.array([[3.0, 1.0, 0.5], [-3, 2, 0.5], [1, 3, 1.0], [9, 9, 0.0]])
    error = np.abs(dose.rate(points) - open_air(points, truth))
    assert (error < 4 * dose.sigma(points) + 0.002).all()
    np.testing.assert_allclose(dose.rate(points), open_air(points, truth), rtol=0.15)
    assert (dose.sigma(points) > 0).all()
    assert np.isfinite(dose.rate(np.array([[1.0, 0.0, 0.2]]))).all()
    assert dose.rate(np.zeros((0, 3))).shape == (0,)


@pytest.mark.slow
def test_sigma_of_the_field_is_its_scatter_over_seeds():
    points = np.array([[2.5, 1.5, 0.5], [-2, -1, 0.5]])
    fields = [surveyed([(0.8, 0.6, 0.3, 10.0)], seed=seed) for seed in range(16)]
    scatter = np.std([dose.rate(points) for dose in fields], axis=0)
    stated = np.mean([dose.sigma(points) for dose in fields], axis=0)
    assert (scatter < 2 * stated).all()
    assert (scatter > stated / 4).all()


def test_measured_is_what_is_near_a_reading():
    dose = surveyed([])
    points = np.array([[0, -3.8, 0.5], [0, -1.0, 0.5], [4, 3, 0.5], [np.nan, 0, 0]])
    np.testing.assert_array_equal(dose.measured_near(points), [True, False, True, False])


# --- walls -----------------------------------------------------------------------------------------------------------


def length_in_box(start, ends, low, high):
    """Length of the lines from one point to others (N, 3) inside an upright box."""
    way = ends - start
    with np.errstate(divide="ignore"):
        faces = (np.array([low, high])[:, None] - start) / way
    enter, leave = faces.min(axis=0).max(axis=1), faces.max(axis=0).min(axis=1)
    return np.maximum(np.minimum(leave, 1) - np.maximum(enter, 0), 0) * np.linalg.norm(way, axis=1)


def hidden_by_wall(seed=0):
    """A source behind a concrete wall of 0.3 m that half of the way looks at; readings, and points of the wall."""
    rng = np.random.default_rng(seed)
    low, high = [-3.0, 1.2, 0.0], [1.0, 1.5, 2.5]
    p_MG = along([(-5, 2), (-5, -1), (5, -1), (5, 2)])
    source = np.array([-1.0, 2.5, 0.3])
    depth = 17.8 * length_in_box(source, p_MG, low, high)
    rate = BACKGROUND + source_dose_rate(40.0, np.linalg.norm(p_MG - source, axis=1), depth)
    return count(rate, p_MG, seed), wall_points(rng, low, high, 20_000), source


@pytest.mark.parametrize("seed", range(3))
def test_map_helps_when_a_wall_stands_between(seed):
    readings, wall, truth = hidden_by_wall(seed)
    with_map, without = (estimate_dose(readings, DoseConfig(), points) for points in (wall, None))
    errors = []
    for dose in (with_map, without):
        strongest = dose.sources[0].p_M if dose.sources else np.full(3, np.inf)
        errors.append(np.linalg.norm(strongest[:2] - truth[:2]))
    assert errors[0] < 0.8
    assert errors[1] > 3 * errors[0]
    assert len(with_map.sources) == 1
    assert with_map.health.dispersion < without.health.dispersion


def test_field_is_dark_behind_the_wall():
    readings, wall, _ = hidden_by_wall()
    dose = estimate_dose(readings, DoseConfig(), wall)
    shaded, open_side = dose.rate(np.array([[-1.0, 0.2, 0.3], [-1.0, 4.8, 0.3]])) - dose.background
    assert shaded < 0.1 * open_side


def test_lines_through_walls_and_cores_are_deep_and_others_are_not():
    rng = np.random.default_rng(0)
    pillar = wall_points(rng, [-0.3, -0.3, 0], [0.3, 0.3, 2.0], 8000)
    floor = np.column_stack([rng.uniform(-4, 4, (40_000, 2)), rng.normal(0, 0.02, 40_000)])
    room = wall_points(rng, [-4, -4, 0], [4, 4, 2.0], 60_000)
    points = np.vstack([pillar, floor, room, [[np.nan, 0, 0]]])
    shadow = VoxelShadow(points, voxel=0.1, attenuation=10.0, max_depth=7.0, clearance=0.3)
    starts = np.array([[-2, 0.03, 1.0], [-2, 1.0, 1.0], [-2, 0, 0.05], [0.0, 2.0, 3.0]])
    depth = shadow.depth(starts, np.array([[2.0, 0.03, 1.0], [-2.0, 3.0, 0.5]]))
    assert depth[0, 0] == pytest.approx(10 * 0.7, abs=1.5)  # the core counts
    assert depth[1, 0] == 0 or depth[1, 0] < 3.5
    assert depth[1, 1] == 0
    assert depth[3, 1] == 0
    assert depth[0, 0] <= 7.0
    passed, doubt = shadow.transmission(starts, np.array([[2.0, 0.03, 1.0]]))
    assert passed[0, 0] < 0.01
    assert ((doubt >= 0) & (doubt < 0.3)).all()


def test_map_without_points_shades_nothing():
    readings, _, _ = hidden_by_wall()
    empty, none = (estimate_dose(readings, DoseConfig(), points) for points in (np.zeros((0, 3)), None))
    np.testing.assert_array_equal(empty.sources[0].p_M, none.sources[0].p_M)


# --- little or bad data ----------------------------------------------------------------------------------------------


def test_few_readings_give_a_background_and_no_source():
    p_MG = np.array([[0, 0, 0.5], [0.1, 0, 0.5], [1, 0, 0.5]])
    dose = estimate_dose(count(open_air(p_MG, [(2, 0, 0, 50)]), p_MG), DoseConfig())
    assert dose.sources == ()
    assert dose.health.state == "few readings"
    assert dose.health.readings == 3
    assert dose.background > 1


def test_robot_that_stands_still_does_not_know_of_sources():
    p_MG = np.tile([1.0, 2.0, 0.5], (200, 1))
    dose = estimate_dose(count(np.full(200, 3.0), p_MG), DoseConfig())
    assert dose.health.state == "few readings"
    assert dose.background == pytest.approx(3.0, rel=0.01)


def test_without_readings_nothing_is_known():
    dose = estimate_dose(DoseReadings(), DoseConfig())
    assert dose.health.state == "few readings"
    assert np.isnan(dose.rate(np.zeros((2, 3)))).all()
    assert np.isinf(dose.sigma(np.zeros((2, 3)))).all()
    assert not dose.measured_near(np.zeros((2, 3))).any()


def test_readings_without_counts_at_all_are_a_background_of_nearly_nothing():
    p_MG = along(ROUND)
    silent = DoseReadings(np.arange(len(p_MG)) * 0.5, np.zeros(len(p_MG), int), np.full(len(p_MG), 0.5), p_MG)
    dose = estimate_dose(silent, DoseConfig())
    assert dose.sources == ()
    assert dose.background < 1e-3
    assert dose.background_sigma > 0


def test_readings_without_live_time_or_place_are_left_out():
    p_MG = along(ROUND)
    readings = count(open_air(p_MG, [(1.5, 0.7, 0.2, 30.0)]), p_MG)
    places, live = readings.p_MG.copy(), readings.live_time.copy()
    places[::7], live[3::7] = np.nan, 0.0
    worse = DoseReadings(readings.time, readings.counts, live, places)
    dose = estimate_dose(worse, DoseConfig())
    assert dose.health.skipped == len(p_MG[::7]) + len(p_MG[3::7])
    assert dose.health.readings + dose.health.skipped == len(p_MG)
    assert np.linalg.norm(dose.sources[0].p_M[:2] - [1.5, 0.7]) < 0.25


def test_readings_of_different_lengths_are_refused():
    with pytest.raises(InputError, match="dose readings: arrays differ in length"):
        DoseReadings(np.zeros(2), np.zeros(3, int), np.zeros(2), np.zeros((2, 3)))


@pytest.mark.parametrize("change", [{"sensitivity": 0.0}, {"max_sources": -1}, {"voxel": 0.0}, {"reach": float("inf")}])
def test_bad_configurations_are_refused(change):
    with pytest.raises(ConfigError, match=f"dose: {next(iter(change))}: out of range"):
        estimate_dose(DoseReadings(), DoseConfig(**change))


# --- the shipped hall ------------------------------------------------------------------------------------------------


def hall(seed):
    world = load_world("stair_hall", seed)
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.004)
    world.add_to(plant)
    plant.Finalize()
    fixed = welded_frames(plant, plant.world_body())
    return RayScene(scene_graph.model_inspector(), world.surface_table(), fixed_frames=fixed)


def true_rate(scene, p_MP):
    rate = np.full(len(p_MP), BACKGROUND)
    for source in scene.sources:
        distance = np.linalg.norm(p_MP - source.p_FQ, axis=1)
        depth = scene.attenuation_along(p_MP, np.array(source.p_FQ))
        rate += source_dose_rate(source.activity, distance, depth)
    return rate


def voxel_map(scene, p_MG, rng):
    """One point in each voxel of 0.1 m that a LiDAR with 1 cm of noise meets on the way."""
    starts = np.repeat(p_MG[::3], 7500, axis=0)
    directions = rng.normal(size=starts.shape)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    distance = scene.cast(starts, directions).distance
    points = (starts + directions * distance[:, None])[np.isfinite(distance)]
    points += rng.normal(0, 0.01, points.shape)
    return points[np.unique(np.floor(points / 0.1).astype(int), axis=0, return_index=True)[1]]


def tour_errors(seed):
    """Error of the position in plan [m], mean relative error of the dose map where measured, of one tour."""
    scene, rng, p_MG = hall(seed), np.random.default_rng(seed), along(TOUR, height=0.4)
    dose = estimate_dose(count(true_rate(scene, p_MG), p_MG, seed), DoseConfig(), voxel_map(scene, p_MG, rng))
    axes = np.arange(-9.75, 10, 0.5), np.arange(-6.75, 7, 0.5), [0.4]
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    grid = grid[dose.measured_near(grid)]
    truth = true_rate(scene, grid)
    map_error = float(np.mean(np.abs(dose.rate(grid) - truth) / truth))
    if not dose.sources:
        return np.inf, map_error
    return float(np.linalg.norm(dose.sources[0].p_M[:2] - scene.sources[0].p_FQ[:2])), map_error


def test_source_in_the_hall_is_found_after_one_tour():
    position_error, map_error = tour_errors(0)
    assert position_error < 0.5
    assert map_error < 0.2


@pytest.mark.slow
def test_source_in_the_hall_is_found_in_twenty_tours():
    errors = np.array([tour_errors(seed) for seed in range(20)])
    for seed, (position, relative) in enumerate(errors):
        print(f"seed {seed}: position {position:.3f} m, map {100 * relative:.1f} %")
    assert np.median(errors[:, 0]) < 0.3
    assert (errors[:, 0] < 0.5).sum() >= 18
    assert (errors[:, 1] < 0.2).all()
