import numpy as np
import pytest
from naraha.systems.localization import EvolutionConfig, OccupancyGrid, evolve, evolve_as_paper, make_field
from naraha.systems.localization.evolution_kernels import hit_share
from naraha.systems.localization.match_kernels import likelihood_fitness, normal_equations
from naraha.systems.localization.planar import difference

from .rooms import rasterised, room, scan_in

TRUTH = np.array([2.6, 2.7, 0.4])
SPREAD = np.array([0.25, 0.25, np.radians(8)])


@pytest.fixture(scope="module")
def grid():
    occupied, origin = rasterised(room())
    return OccupancyGrid.from_plan(occupied, 0.05, origin)


@pytest.fixture(scope="module")
def points():
    return scan_in(room(), TRUTH, np.random.default_rng(1)).p_SP[::3]


@pytest.mark.parametrize("seed", range(5))
def test_a_pose_that_is_far_off_is_found(grid, points, seed):
    start = TRUTH + SPREAD * np.random.default_rng(seed).uniform(-1.5, 1.5, 3)
    information = np.diag(1 / (4 * SPREAD) ** 2)
    found = evolve(make_field(grid), points, start, SPREAD, information, 20.0, EvolutionConfig(), seed=seed, index=0)
    error = np.abs(difference(TRUTH, found))
    assert error[:2].max() < 0.06
    assert error[2] < np.radians(1.5)


@pytest.mark.parametrize("seed", range(3))
def test_the_strategy_of_the_paper_finds_it_to_a_cell(grid, points, seed):
    start = TRUTH + SPREAD * np.random.default_rng(seed).uniform(-0.8, 0.8, 3)
    found, fitness, covariance = evolve_as_paper(grid, points, start, SPREAD, EvolutionConfig(), seed=seed, index=0)
    assert np.abs(difference(TRUTH, found))[:2].max() < 0.1
    assert fitness == hit_share(grid.log_odds, *grid.origin, grid.resolution, points, found)
    assert fitness > hit_share(grid.log_odds, *grid.origin, grid.resolution, points, start)
    assert np.linalg.eigvalsh(covariance).min() >= 0


def test_beams_that_end_where_nothing_is_known_are_no_hits():
    log_odds = np.zeros((10, 10), np.float32)
    log_odds[5, :] = 2.0
    log_odds[:5] = -2.0
    ends = np.array([[0.525, 0.225], [0.525, 0.325], [0.825, 0.225], [0.225, 0.225], [3.0, 0.2]])
    assert hit_share(log_odds, 0.0, 0.0, 0.1, ends, np.zeros(3)) == pytest.approx(2 / 5)
    assert hit_share(log_odds, 0.0, 0.0, 0.1, ends, np.array([0.3, 0.0, 0.0])) == pytest.approx(1 / 5)


def test_one_seed_gives_one_answer_and_another_another(grid, points):
    arguments = (make_field(grid), points, np.add(TRUTH, [0.2, -0.1, 0.05]), SPREAD, np.eye(3), 20.0, EvolutionConfig())
    first, again = (evolve(*arguments, seed=3, index=7) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert (evolve(*arguments, seed=3, index=8) != first).any()
    assert (evolve(*arguments, seed=4, index=7) != first).any()


def test_fitness_is_one_where_all_beams_end_on_walls_and_falls_with_the_distance(grid):
    field = make_field(grid)
    arguments = (field.signed, *field.origin, field.resolution, field.reach / field.resolution)
    points = scan_in(room(), TRUTH).p_SP
    values = [likelihood_fitness(*arguments, points, np.add(TRUTH, [d, 0, 0]), 0.1) for d in (0, 0.05, 0.1, 0.2)]
    assert values[0] > 0.97
    assert values == sorted(values, reverse=True)
    # A wall square to the shift is 0.1 off: exp(-1/2) of its beams; those along it lose nothing.
    wall = np.column_stack([np.full(50, 1.0), np.linspace(-1, 1, 50)])
    pose = np.array([7.0 - 0.1, 3.5, 0.0])
    assert likelihood_fitness(*arguments, wall, pose, 0.1) == pytest.approx(np.exp(-0.5), abs=1e-5)


def test_the_slope_of_the_normal_equations_is_that_of_the_squared_distances(grid):
    """With one patch a beam and no robust weights, g is half the gradient of Σ d² / σ², by finite differences."""
    field = make_field(grid)
    points = scan_in(room(), TRUTH).p_SP[::9]
    X = np.add(TRUTH, [0.0213, -0.0117, 0.0031])
    patch = np.arange(len(points))
    arguments = (field.signed, *field.origin, field.resolution, field.reach / field.resolution, points, patch)
    noise, far = 0.02, 1e6
    A, _, g, cost, used = normal_equations(*arguments, X, noise, 0.0, far)

    def squares(X):
        return normal_equations(*arguments, X, noise, 0.0, far)[3]

    h = 1e-7
    slope = [(squares(X + h * e) - squares(X - h * e)) / (2 * h) for e in np.eye(3)]
    np.testing.assert_allclose(2 * g, slope, rtol=1e-4)
    assert used == len(points)
    assert cost == pytest.approx(squares(X))
    assert np.linalg.eigvalsh(A).min() > 0


def test_what_beams_on_a_patch_share_is_counted_once(grid):
    """n beams on one patch of a wall: σ² / n + shared² is left of it, by the closed form."""
    field = make_field(grid)
    wall = np.column_stack([np.full(40, 1.0), np.linspace(-0.2, 0.2, 40)])
    pose = np.array([7.0, 3.5, 0.0])
    arguments = (field.signed, *field.origin, field.resolution, field.reach / field.resolution, wall)
    A, T, *_ = normal_equations(*arguments, np.zeros(40, int), pose, 0.02, 0.03, 1e6)
    assert 1 / A[0, 0] == pytest.approx(0.02**2 / 40 + 0.03**2, rel=1e-4)
    assert A[1, 1] == pytest.approx(0, abs=1e-6)
    assert T[1, 1] == pytest.approx(A[0, 0])
