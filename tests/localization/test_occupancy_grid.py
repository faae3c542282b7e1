import numpy as np
import pytest
from naraha.systems.errors import ConfigError
from naraha.systems.localization import OccupancyConfig, OccupancyGrid, OccupancyGridError, make_field

from .rooms import rasterised, rectangle, room, scan_in

CONFIG = OccupancyConfig()


def value_at(grid, x, y):
    i, j = np.floor(grid.cells_of(np.array([[x, y]]))[0]).astype(int)
    return grid.log_odds[i, j]


def map_of_wall(angle, distance, noise=0.0, poses=1):
    """A grid in which a long wall at some angle and distance from the origin was seen from near it."""
    n = np.array([np.cos(angle), np.sin(angle)])
    along = np.array([-n[1], n[0]])
    wall = np.array([[distance * n - 20 * along, distance * n + 20 * along]])
    rng = np.random.default_rng(0)
    grid = OccupancyGrid.empty()
    for k in range(poses):
        X = np.array([*(0.3 * (k - poses / 2) * along), angle])
        scan = scan_in(wall, X, rng, noise=noise, angles=np.radians(np.linspace(-40, 40, 321)))
        grid = grid.with_scan(scan.p_SP, X, number=k)
    return grid, n, along


def test_a_beam_frees_what_it_crosses_and_hits_where_it_ends():
    grid = OccupancyGrid.empty().with_scan(np.array([[1.02, 0.0]]), np.array([0.02, 0.02, 0.0]))
    assert value_at(grid, 1.04, 0.02) == pytest.approx(CONFIG.hit)
    for x in (0.02, 0.5, 0.98):
        assert value_at(grid, x, 0.02) == pytest.approx(CONFIG.miss)
    for x, y in ((1.12, 0.02), (0.5, 0.12), (-0.1, 0.02)):
        assert value_at(grid, x, y) == 0


def test_the_cells_that_a_slanted_beam_crosses_are_those_that_lie_on_it():
    start, end = np.array([0.013, 0.021]), np.array([2.003, 1.317])
    grid = OccupancyGrid.empty().with_scan((end - start)[None], np.array([*start, 0.0]))
    points = start + np.linspace(0, 1, 20001)[:, None] * (end - start)
    crossed = {tuple(ij) for ij in np.floor(grid.cells_of(points)).astype(int)}
    assert {tuple(ij) for ij in np.argwhere(grid.free)} == crossed - {tuple(ij) for ij in np.argwhere(grid.occupied)}


def test_evidence_adds_up_and_stops():
    grid = OccupancyGrid.empty()
    for _ in range(20):
        grid = grid.with_scan(np.array([[1.02, 0.0]]), np.array([0.02, 0.02, 0.0]))
    assert value_at(grid, 1.04, 0.02) == CONFIG.highest
    assert value_at(grid, 0.5, 0.02) == CONFIG.lowest
    for _ in range(20):  # what stood there has gone
        grid = grid.with_scan(np.array([[2.02, 0.0]]), np.array([0.02, 0.02, 0.0]))
    assert value_at(grid, 1.04, 0.02) == CONFIG.lowest
    assert not grid.hits[tuple(np.floor(grid.cells_of(np.array([[1.04, 0.02]]))[0]).astype(int))].any()


def test_a_grid_grows_without_moving_and_the_old_one_stays_as_it_was():
    first = OccupancyGrid.empty().with_scan(np.array([[1.02, 0.0]]), np.array([0.02, 0.02, 0.0]))
    before = first.log_odds.copy()
    grown = first.with_scan(np.array([[9.0, 0.0]]), np.array([-5.0, -4.0, -2.0]))
    assert value_at(grown, 1.04, 0.02) == pytest.approx(CONFIG.hit)
    np.testing.assert_array_equal(first.log_odds, before)
    assert min(grown.shape) > min(first.shape)
    low_x, high_x, low_y, high_y = grown.extent
    assert low_x < -9
    assert low_y < -12
    assert high_x > 1
    assert high_y > 0


def test_a_sharper_map_has_less_entropy():
    walls, rng = room(), np.random.default_rng(0)
    X = np.array([2.0, 3.0, 0.0])
    sharp = blurred = OccupancyGrid.empty()
    for _ in range(8):
        scan = scan_in(walls, X, rng)
        sharp = sharp.with_scan(scan.p_SP, X)
        blurred = blurred.with_scan(scan.p_SP, X + rng.normal(0, [0.1, 0.1, 0.03]))
    assert sharp.entropy() < 0.8 * blurred.entropy()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: OccupancyGrid(np.zeros(4), np.zeros(2), 0.05), "nx, ny"),
        (lambda: OccupancyGrid(np.zeros((4, 4)), np.zeros(2), 0.0), "resolution"),
        (lambda: OccupancyGrid(np.full((4, 4), np.nan), np.zeros(2), 0.05), "finite"),
        (lambda: OccupancyGrid.empty().with_scan(np.array([[1.0, 0]]), np.array([0, np.nan, 0])), "finite"),
        (lambda: OccupancyGrid.empty().with_scan(np.array([[1.0, 0]]), np.zeros(3)).with_scan(
            np.array([[1.0, 0]]), np.array([1e5, 1e5, 0])), "too far"),
        (lambda: make_field(OccupancyGrid(np.zeros((4, 4)), np.zeros(2), 0.05), reach=0.01), "reach"),
    ],
)  # fmt: skip
def test_what_makes_no_grid_is_refused(make, message):
    with pytest.raises(OccupancyGridError, match=message):
        make()


def test_a_wrong_configuration_is_refused():
    with pytest.raises(ConfigError, match=r"occupancy.resolution"):
        OccupancyGrid.empty(OccupancyConfig(resolution=-1.0))


def test_the_distance_to_a_planned_wall_is_that_to_its_face():
    occupied, origin = rasterised(rectangle(0, 0, 4, 3))
    field = make_field(OccupancyGrid.from_plan(occupied, 0.05, origin))
    y = np.linspace(1.0, 2.0, 7)
    for x, expected in ((0.0, 0.0), (0.1, 0.1), (0.313, 0.313), (-0.2, -0.2), (3.9, 0.1), (2.0, 0.5)):
        np.testing.assert_allclose(field.distance(np.column_stack([np.full(7, x), y])), expected, atol=1e-6)
    np.testing.assert_allclose(field.distance(np.array([[100.0, 0.0]])), 0.5)


@pytest.mark.parametrize("angle", [0.0, 0.3, 0.785, 1.4])
@pytest.mark.parametrize("distance", [2.0, 2.013, 2.037])
def test_the_distance_to_a_mapped_wall_is_exact_to_a_fraction_of_a_cell(angle, distance):
    grid, n, along = map_of_wall(angle, distance)
    field = make_field(grid)
    t, d = np.meshgrid(np.linspace(-0.8, 0.8, 33), np.linspace(-0.2, 0.2, 9))
    points = (distance - d.ravel())[:, None] * n + t.ravel()[:, None] * along
    np.testing.assert_allclose(field.distance(points), d.ravel(), atol=0.004)


def test_noise_of_the_beams_averages_out_of_a_mapped_wall():
    grid, n, along = map_of_wall(0.3, 2.0, noise=0.01, poses=6)
    points = 1.9 * n + np.linspace(-0.8, 0.8, 65)[:, None] * along
    distance = make_field(grid).distance(points)
    assert np.std(distance) < 0.003
    assert abs(np.mean(distance) - 0.1) < 0.002
    # Along the wall it hardly changes: there is nothing to hold on to.
    assert np.abs(np.diff(distance) / 0.025).mean() < np.tan(np.radians(3))


def test_beyond_the_end_of_what_was_seen_there_is_no_distance():
    grid, n, along = map_of_wall(0.0, 2.0)
    beyond = 2.0 * n + 1.9 * along  # the outermost beam ended at 1.68
    assert make_field(grid).distance(beyond[None])[0] == pytest.approx(0.5)


def test_a_field_that_is_made_anew_in_part_is_that_made_as_a_whole():
    walls, rng = room(), np.random.default_rng(3)
    grid = OccupancyGrid.empty()
    field = make_field(grid)
    for k, X in enumerate(np.array([[2.0, 3.0, 0.0], [4.0, 3.5, 2.0], [5.0, 4.0, -1.0]])):
        scan = scan_in(walls, X, rng)
        c, s = np.cos(X[2]), np.sin(X[2])
        ends = scan.p_SP @ np.array([[c, s], [-s, c]]) + X[:2]
        grid = grid.with_scan(scan.p_SP, X, number=k)
        box = np.minimum(ends.min(axis=0), X[:2]), np.maximum(ends.max(axis=0), X[:2])
        field = make_field(grid, before=field, changed=box)
        whole = make_field(grid)
        np.testing.assert_array_equal(field.signed, whole.signed)
        np.testing.assert_array_equal(field.owner, whole.owner)
