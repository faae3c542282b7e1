"""Different ways to one goal: found where they exist, never twice the same, and what is said of them is true."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.errors import ConfigError, InputError
from naraha.systems.routes import FENCE, FREE, OCCUPIED, UNKNOWN, WATER, RouteGrid, RoutesConfig, slipping
from naraha.systems.routes.find_routes import blocked_at, find_routes, find_ways, is_open
from naraha.systems.routes.ground import make_ground
from naraha.systems.routes.islands import find_islands
from naraha.systems.routes.path_smoothing import clearance_along
from scipy.ndimage import label

from .maps import fenced, hall_map, maze_map, water_map


def encloses_an_obstacle(a, b, grid):
    """Whether the loop along one route and back along the other winds round a blocked cell, by summing angles."""
    loop = np.vstack([a.xy, b.xy[::-1], a.xy[:1]])
    cells = np.argwhere(grid.blocked)
    away = loop - grid.centre_of(cells)[:, None]
    angles = np.unwrap(np.arctan2(away[..., 1], away[..., 0]), axis=1)
    return bool((np.abs(angles[:, -1] - angles[:, 0]) > 1).any())


def sides_of_water(routes):
    return {words.split(" of ")[0] for route in routes for words in route.sides if "water" in words}


def open_hall(nx=30, ny=20, cell=0.2):
    return RouteGrid.from_kind(fenced(nx, ny), cell)


@pytest.mark.parametrize("seed", range(50))
def test_both_sides_of_the_water_are_found_and_no_way_twice(seed):
    grid, start, goal = water_map(seed)
    routes = find_routes(grid, start, np.array(goal))
    assert sides_of_water(routes) == {"left", "right"}
    for i, a in enumerate(routes):
        for b in routes[:i]:
            assert a.signature != b.signature
            assert encloses_an_obstacle(a, b, grid)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("seed", range(10))
def test_only_the_side_that_is_there_is_found(seed, side):
    grid, start, goal = water_map(seed, side)
    routes = find_routes(grid, start, np.array(goal))
    assert routes
    assert all(is_open(route, grid) for route in routes)
    pool = grid.kind == WATER
    # The dammed side is closed from the pool's middle to the fence, so no route may cross there.
    parts, _ = label(np.pad(grid.blocked, 1, constant_values=True), np.ones((3, 3)))
    assert set(np.unique(parts[1:-1, 1:-1][pool])) == {parts[0, 0]}


@pytest.mark.parametrize("seed", range(10))
def test_where_no_way_leads_there_is_no_route(seed):
    grid, start, goal = water_map(seed, "none")
    assert find_routes(grid, start, np.array(goal)) == ()


@pytest.mark.parametrize("make", [hall_map, maze_map, water_map])
@pytest.mark.parametrize("seed", range(5))
def test_routes_stay_in_free_cells_and_end_where_they_should(make, seed):
    grid, start, goal = make(seed)
    routes = find_routes(grid, start, np.array(goal))
    assert routes
    for route in routes:
        assert is_open(route, grid)
        np.testing.assert_allclose(route.xy[0], start[:2])
        np.testing.assert_allclose(route.xy[-1], goal)
        assert route.clearance_m == pytest.approx(clearance_along(route.xy, grid).min())
        assert route.clearance_m > 0.5 * grid.cell
        assert np.linalg.norm(np.diff(route.xy, axis=0), axis=1).max() < 0.11


def test_the_first_way_is_the_cheapest_and_every_class_is_at_its_best():
    """Against a search of each class on its own: every other island's side closed by a dam."""
    kind = fenced(30, 20)
    kind[12:16, 8:12] = WATER
    grid, config = RouteGrid.from_kind(kind, 0.2), RoutesConfig()
    first, last = np.array([3, 10]), np.array([26, 9])

    def ways(kind):
        closed = RouteGrid.from_kind(kind, 0.2, clearance=grid.clearance)
        return find_ways(closed, make_ground(closed, config), find_islands(closed), first, last, config)

    found = ways(kind)
    assert len(found) == 2
    above, below = kind.copy(), kind.copy()
    above[13, 1:8] = OCCUPIED
    below[13, 12:19] = OCCUPIED
    single = sorted([ways(above)[0].cost, ways(below)[0].cost])
    np.testing.assert_allclose([way.cost for way in found], single)


def test_a_large_detour_is_found_among_many_small_pillars():
    kind = fenced(60, 40)
    kind[20:40, 4:24] = WATER
    for i in range(3, 57, 4):
        for j in range(27, 38, 4):
            kind[i, j] = OCCUPIED
    grid = RouteGrid.from_kind(kind, 0.1)
    start, goal = np.append(grid.centre_of([5, 13]), 0), grid.centre_of([55, 13])
    assert sides_of_water(find_routes(grid, start, goal)) == {"left", "right"}


def test_no_way_goes_past_the_goal_and_back_between_two_islands():
    kind = fenced(60, 40)
    kind[20:40, 10:16] = kind[20:40, 24:30] = OCCUPIED
    grid = RouteGrid.from_kind(kind, 0.1)
    routes = find_routes(grid, grid.centre_of([5, 20]), grid.centre_of([55, 20]), RoutesConfig(most=10))
    assert len(routes) == 3
    for route in routes:
        assert (np.diff(route.xy[:, 0]) > -0.02).all()


def test_sides_are_those_that_a_driver_sees():
    kind = fenced(30, 21)
    kind[14:17, 9:12] = WATER
    grid = RouteGrid.from_kind(kind, 0.2)
    west, east = grid.centre_of([3, 10]), grid.centre_of([26, 10])
    for start, goal, sign in ((west, east, 1), (east, west, -1)):
        for route in find_routes(grid, start, goal):
            middle = route.xy[len(route.xy) // 2, 1] - grid.centre_of([15, 10])[1]
            # Driving east, the left is where y is larger.
            assert route.sides == (("left" if sign * middle > 0 else "right") + " of water",)


def test_a_thin_pole_makes_no_second_way():
    kind = fenced(60, 40)
    kind[30, 20] = OCCUPIED
    grid = RouteGrid.from_kind(kind, 0.1)
    args = (grid, grid.centre_of([10, 20]), grid.centre_of([50, 20]))
    assert len(find_routes(*args)) == 1
    assert len(find_routes(*args, RoutesConfig(separation=0.2))) == 2


def test_cost_draws_the_route_away_from_what_is_risky():
    grid = open_hall()
    cost = np.ones(grid.shape)
    cost[12:18, :14] = 5.0
    risky = RouteGrid.from_kind(grid.kind, 0.2, cost=cost)
    start, goal = grid.centre_of([3, 9]), grid.centre_of([26, 9])
    straight, around = (find_routes(g, start, goal)[0] for g in (grid, risky))
    assert np.ptp(straight.xy[:, 1]) < 0.05
    assert around.xy[:, 1].max() > 14 * 0.2


def test_dose_and_time_of_a_straight_route_are_those_on_paper():
    grid = open_hall()
    hot = RouteGrid.from_kind(grid.kind, 0.2, dose_rate=np.full(grid.shape, 360.0))
    start, goal = np.append(grid.centre_of([5, 10]), np.pi / 2), grid.centre_of([20, 10])
    (route,) = find_routes(hot, start, goal, RoutesConfig(speed=0.3, turn_rate=0.5))
    assert route.length_m == pytest.approx(3.0)
    assert route.time_s == pytest.approx(10 + np.pi / 2 / 0.5, rel=1e-3)
    assert route.dose == pytest.approx(0.1 * route.time_s, rel=1e-3)


def ramp(slope, across=False):
    kind = fenced(40, 30)
    i, j = np.meshgrid(np.arange(40), np.arange(30), indexing="ij")
    run = np.clip((j - 10 if across else i - 15) * 0.1, 0, 1)
    return RouteGrid.from_kind(kind, 0.1, height=slope * run)


def test_a_ramp_is_climbed_straight_and_its_slope_said():
    grid = ramp(0.6)
    start, goal = grid.centre_of([5, 7]), grid.centre_of([35, 22])
    route = find_routes(grid, start, goal)[0]
    assert route.steepest_rad == pytest.approx(np.arctan(0.6), abs=0.02)
    assert route.tilt_rad < RoutesConfig().max_roll
    assert route.z[-1] - route.z[0] == pytest.approx(0.6, abs=0.02)
    on_ramp = (route.xy[:, 0] > 1.75) & (route.xy[:, 0] < 2.25)
    assert np.ptp(route.xy[on_ramp, 1]) < 0.05


def test_too_steep_a_ramp_is_no_way():
    assert find_routes(ramp(2.0), np.array([0.55, 0.75]), np.array([3.55, 2.25])) == ()


def test_unseen_ground_and_narrow_places_make_a_route_less_sure():
    seen = open_hall()
    kind = seen.kind.copy()
    kind[8:22, 11:] = UNKNOWN
    start, goal = seen.centre_of([3, 9]), seen.centre_of([26, 9])
    sure, unsure = (find_routes(RouteGrid.from_kind(k, 0.2), start, goal)[0].confidence for k in (seen.kind, kind))
    assert sure == 1
    assert unsure < 0.95
    kind = fenced(30, 20)
    kind[14, :] = FENCE
    kind[14, 9] = FREE
    narrow = RouteGrid.from_kind(np.where(kind == FENCE, OCCUPIED, kind), 0.2)
    (gap,) = find_routes(narrow, start, goal)
    (slip,) = find_routes(narrow, start, goal, motion=slipping(0.1, 0.1))
    assert gap.confidence == 1
    assert slip.confidence < 0.95


def test_a_route_that_a_new_obstacle_closes_is_noticed_and_where():
    grid = open_hall()
    (route,) = find_routes(grid, grid.centre_of([3, 10]), grid.centre_of([26, 10]))
    assert blocked_at(route, grid) is None
    kind = grid.kind.copy()
    kind[15, 10] = OCCUPIED
    newer = RouteGrid.from_kind(kind, 0.2)
    assert not is_open(route, newer)
    assert blocked_at(route, newer) == pytest.approx(15 * 0.2 - 3.5 * 0.2, abs=0.1)
    smaller = RouteGrid.from_kind(fenced(20, 20), 0.2)
    assert blocked_at(route, smaller) == pytest.approx(19 * 0.2 - 3.5 * 0.2, abs=0.1)


@pytest.mark.parametrize(
    ("start", "goal", "message"),
    [
        ([0.1, 0.1, 0], [3, 2], "start: in a cell that is fence.*nearest free cell"),
        ([1, 1, 0], [99, 2], "goal: outside the grid"),
        ([1, np.nan, 0], [3, 2], "start: not a pose"),
        ([1, 1, 0], [3], "goal: not a place"),
    ],
)
def test_bad_places_are_named(start, goal, message):
    with pytest.raises(InputError, match=message):
        find_routes(open_hall(), np.array(start, float), np.array(goal, float))


def test_bad_config_is_refused():
    with pytest.raises(ConfigError, match=r"routes\.max_stretch"):
        find_routes(open_hall(), np.array([1, 1, 0]), np.array([2, 2]), RoutesConfig(max_stretch=0.5))


@given(st.integers(0, 10_000))
def test_the_signature_of_a_loop_counts_the_islands_inside(seed):
    rng = np.random.default_rng(seed)
    kind = np.zeros((16, 14), np.uint8)
    kind[tuple(rng.integers(2, 12, (2, 6)))] = OCCUPIED
    grid = RouteGrid.from_kind(kind, 0.3, (-1, 2))
    islands = find_islands(grid)
    loop = grid.centre_of(np.array([[0, 0], [15, 0], [15, 13], [0, 13], [0, 0]]))
    # The far side of a loop to the left is driven along -x, above all rays' beginnings.
    assert islands.signature(grid, loop) == (-1,) * len(islands)
    assert islands.signature(grid, loop[::-1]) == (1,) * len(islands)
    np.testing.assert_allclose(np.ptp(islands.bearings(grid, loop), axis=1), 2 * np.pi)
