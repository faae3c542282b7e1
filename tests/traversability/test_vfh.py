from dataclasses import replace
from itertools import groupby, pairwise

import numpy as np
import pytest
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.traversability import (
    IMPASSABLE,
    FuzzyVfhController,
    RiskHistogram,
    TerrainConfig,
    VfhConfig,
    describe_terrain,
    make_histogram,
)
from naraha.systems.traversability.fuzzy_vfh_controller import downhill_of
from naraha.systems.traversability.vfh_choice import (
    best_direction,
    nearest_to_goal,
    nearness,
    place_to_turn,
    room_behind,
    turn_depth,
    wrapped,
)
from naraha.systems.traversability.vfh_decide import decide
from naraha.systems.traversability.vfh_state import Sight, VfhState
from naraha.systems.traversability.wavefront import (
    ALWAYS,
    IF_UNSEEN,
    WavefrontConfig,
    find_way,
    spread_costs,
)
from naraha.systems.traversability.wavefront_kernels import costs_to_goal
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from tests.traversability.unicycle_world import pioneer, run, scan

CONFIG = VfhConfig()
WALL = 0.2
U_SHAPE = [(3, -1.5, 3 + WALL, 1.5), (0, 1.5, 3 + WALL, 1.5 + WALL), (0, -1.5 - WALL, 3 + WALL, -1.5)]
ROOM = [(-2, -2, 2, -2 + WALL), (-2, 2 - WALL, 2, 2), (-2, -2, -2 + WALL, 2), (2 - WALL, -2, 2, 2)]
CORRIDOR = [(-1, 1, 8, 1.2), (-1, -1.2, 8, -1), (3, -0.2, 3.3, 0.1)]
TWO_GAPS = [(2, -0.4, 2.3, 0.4), (2, -4, 2.3, -1.4), (2, 1.4, 2.3, 4)]


def histogram(passable, risk=20.0):
    directions = np.deg2rad(np.linspace(-80, 80, len(passable)))
    passable = np.array(passable, bool)
    edges = 1.3 * np.column_stack([np.cos(directions), np.sin(directions)])
    return RiskHistogram(directions, np.where(passable, risk, IMPASSABLE), passable, 3 * ~passable, edges)


def sight(passable=(1,) * 9, goal=(5.0, 0.0), pose=(0.0, 0.0, 0.0), time=0.0, **values):
    goal = np.array(goal, float)
    given = {"field": None, "index": 0, "way": goal, "obstacles": np.zeros((0, 2))} | values
    return Sight(time=time, pose=np.array(pose, float), goal=goal, histogram=histogram(passable), **given)


def field_of(risk, goal, robot, config=None, **values):
    return spread_costs(
        np.array(risk, np.float32),
        np.zeros(2),
        0.1,
        np.array(goal, float),
        np.array(robot, float),
        pioneer(),
        config or WavefrontConfig(),
        **values,
    )


def turns(run_):
    """Signs of the turns on the spot, one for each stretch of them."""
    signs = []
    for status, steps in groupby(range(1, len(run_.statuses)), key=lambda n: run_.statuses[n]):
        steps = list(steps)
        if status == "turning":
            signs.append(np.sign(run_.poses[steps[-1], 2] - run_.poses[steps[0] - 1, 2]))
    return signs


# The choice


@pytest.mark.parametrize(("goal", "chosen"), [((5, 0), 4), ((1, 5), 8), ((0.5, -2), 0), ((-5, -0.1), 0)])
def test_the_papers_choice_is_the_far_edge_nearest_to_the_goal(goal, chosen):
    assert nearest_to_goal(histogram([1] * 9), np.array(goal)) == chosen


def test_the_papers_choice_leaves_out_what_is_not_passable():
    assert nearest_to_goal(histogram([1, 1, 1, 0, 0, 0, 0, 1, 1]), np.array([5, 0])) == 2
    assert nearest_to_goal(histogram([0] * 9), np.array([5, 0])) is None


def test_of_two_directions_as_good_the_one_driven_in_so_far_is_kept():
    seen = sight([1, 1, 1, 1, 0, 1, 1, 1, 1])
    for aim, chosen in ((np.deg2rad(20), 5), (np.deg2rad(-20), 3)):
        for wanted in np.deg2rad([-2, 2]):
            assert best_direction(seen, wanted, aim, VfhConfig()) == chosen


def test_room_to_turn_is_that_of_the_rectangle():
    footprint = [1.0, 0.5]
    beside = np.array([[0.0, 0.35]])
    assert np.isclose(turn_depth(beside, footprint, np.pi / 2), 0.15, atol=0.02)
    assert turn_depth(np.array([[0.0, 0.6]]), footprint, np.pi / 2) <= 0
    ahead_left = np.array([[0.45, 0.3]])
    assert turn_depth(ahead_left, footprint, 0.3) > 0
    assert turn_depth(ahead_left, footprint, -0.3) <= 0
    assert turn_depth(np.zeros((0, 2)), footprint, np.pi) <= 0


def test_a_turn_on_a_slope_needs_the_room_that_it_slides_into():
    footprint, behind = [1.0, 0.5], np.array([[-0.75, 0.0]])
    # It slides by -s cos(a) along (cos(a), sin(a)): half a turn takes its middle π/2 s back.
    up, half_a_turn = (-0.2, 0.0), np.pi
    assert turn_depth(behind, footprint, half_a_turn) <= 0
    gone = 0.2 * np.pi / 2
    assert np.isclose(turn_depth(behind, footprint, half_a_turn, up), 0.5 + gone - 0.75, atol=0.01)
    assert turn_depth(-behind, footprint, half_a_turn, up) <= 0
    # Across the slope it slides when it faces it, however it began.
    assert turn_depth(np.array([[0.1, -0.6]]), footprint, -np.pi / 2, (0.0, -0.3)) > 0.05


def test_what_a_robot_touches_must_not_get_farther_in_by_a_turn():
    footprint = [1.0, 0.5]
    front_left = np.array([[0.2, 0.22]])
    assert turn_depth(front_left, footprint, 0.5) > 0
    assert turn_depth(front_left, footprint, -0.5) <= 0
    assert turn_depth(np.array([[0.1, 0.05]]), footprint, np.pi) <= 0  # it stands on that


def test_the_place_to_turn_is_the_nearest_with_room_or_the_least_bad_one():
    footprint, level = [1.0, 0.5], (0.0, 0.0)
    wall = np.column_stack([np.linspace(0, 1, 11), np.full(11, 0.35)])
    assert place_to_turn(wall, footprint, np.pi / 2, level, 1.0) == pytest.approx(0.5, abs=0.11)
    assert place_to_turn(wall + np.array([3, 0]), footprint, np.pi / 2, level, 1.0) == 0
    everywhere = np.column_stack([np.linspace(-3, 3, 61), np.full(61, 0.35)])
    assert place_to_turn(everywhere, footprint, np.pi / 2, level, 1.0) == 0
    closed_behind = np.vstack([wall, [[-0.65, 0.1]]])
    assert place_to_turn(closed_behind, footprint, np.pi / 2, level, 1.0) <= 0.15


def test_room_behind_is_the_strip_behind():
    assert not room_behind(np.array([[-0.6, 0.1]]), [1.0, 0.5])
    assert room_behind(np.array([[-0.6, 0.3], [0.6, 0.0], [-0.8, 0.0]]), [1.0, 0.5])


def test_what_the_robot_hangs_on_does_not_keep_it_from_backing_up():
    assert room_behind(np.array([[-0.3, 0.1]]), [1.0, 0.5])
    assert not room_behind(np.array([[-0.45, 0.1]]), [1.0, 0.5])


# The wavefront


def test_costs_are_those_of_dijkstra_on_the_same_graph():
    rng = np.random.default_rng(0)
    price = rng.uniform(1, 6, (30, 25)).astype(np.float32)
    price[rng.random(price.shape) < 0.25] = np.inf
    price[3, 4] = 1.0
    rows, columns, weights = [], [], []
    for i, j in np.ndindex(price.shape):
        for di, dj in ((1, 0), (0, 1), (1, 1), (1, -1)):
            p, q = i + di, j + dj
            if not (0 <= p < 30 and 0 <= q < 25):
                continue
            past = price[p, j] + price[i, q] if di and dj else 0.0
            if np.isfinite(price[i, j] + price[p, q] + past):
                rows.append(i * 25 + j)
                columns.append(p * 25 + q)
                weights.append(np.hypot(di, dj) * 0.5 * (price[i, j] + price[p, q]))
    graph = coo_array((weights, (rows, columns)), shape=(750, 750))
    expected = dijkstra(graph.tocsr(), directed=False, indices=3 * 25 + 4)
    found = costs_to_goal(price, np.array([3 * 25 + 4]), np.zeros(1)).ravel()
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_the_way_over_open_ground_is_straight():
    field = field_of(np.full((80, 60), 17.0), (6.5, 4.3), (0.5, 0.7))
    np.testing.assert_allclose(find_way(field, np.array([0.5, 0.7])), (6.5, 4.3))


def test_the_way_goes_downhill_to_the_goal_from_everywhere():
    rng = np.random.default_rng(1)
    risk = np.full((60, 60), 17.0)
    risk[rng.random(risk.shape) < 0.02] = IMPASSABLE
    field = field_of(risk, (5.0, 5.0), (0.5, 0.5))
    for start in rng.uniform(0.5, 5.5, (50, 2)):
        path = field.path(start)
        if not len(path):
            continue
        cost = [field.cost[tuple(np.floor((p - field.origin) / 0.1).astype(int))] for p in path]
        assert all(b < a for a, b in pairwise(cost))
        assert np.hypot(*(path[-1] - 5.0)) < 0.3


def test_a_gap_narrower_than_the_robot_is_closed_and_a_wide_one_is_open():
    for gap, open_ in ((2, False), (8, True)):
        risk = np.full((40, 40), 17.0)
        risk[20, :] = IMPASSABLE
        risk[20, 10 : 10 + gap] = 17
        risk[[0, -1]], risk[:, [0, -1]] = IMPASSABLE, IMPASSABLE
        closed = field_of(risk, (3.5, 2.0), (0.5, 2.0))
        assert (find_way(closed, np.array([0.5, 2.0])) is not None) == open_


def test_risky_ground_is_gone_around_when_that_takes_less_time_and_crossed_when_not():
    ways = []
    for risk_of_strip in (22.0, 55.0):
        risk = np.full((60, 80), 17.0)
        risk[20:40, 30:50] = risk_of_strip
        field = field_of(risk, (5.5, 4.0), (0.5, 4.0))
        ways.append(np.abs(field.path(np.array([0.5, 4.0]))[:, 1] - 4.0).max())
    assert ways[0] < 0.3
    assert ways[1] > 0.9


def test_a_narrow_gap_is_gone_around_when_a_wide_one_is_not_far():
    risk = np.full((60, 60), 17.0)
    risk[26:34, :38] = IMPASSABLE
    risk[26:34, 27:32] = 17.0  # 0.5 m, wide enough for a robot of 0.38 m
    for config, around in ((WavefrontConfig(), True), (WavefrontConfig(narrow_price=1.0), False)):
        path = field_of(risk, (5.0, 3.0), (1.0, 3.0), config).path(np.array([1.0, 3.0]))
        assert (path[:, 1].max() > 4.0) == around
    risk[26:34, 33:] = IMPASSABLE
    assert find_way(field_of(risk, (5.0, 3.0), (1.0, 3.0)), np.array([1.0, 3.0])) is not None


def test_unseen_ground_is_crossed_at_a_price_and_a_goal_outside_is_headed_for():
    risk = np.full((40, 40), np.nan)
    field = field_of(risk, (3.5, 2.0), (0.5, 2.0))
    assert field.cost[tuple(np.floor((np.array([0.5, 2.0]) - field.origin) / 0.1).astype(int))] == pytest.approx(
        3.0 * WavefrontConfig().unknown_price, abs=0.4
    )
    way = find_way(field_of(risk, (20.0, 2.0), (0.5, 2.0)), np.array([0.5, 2.0]))
    assert way[0] > 3
    assert abs(way[1] - 2) < 0.3


def test_a_goal_in_a_wall_or_behind_walls_has_no_way():
    risk = np.full((60, 60), 17.0)
    risk[30:45, 20:40] = IMPASSABLE
    assert find_way(field_of(risk, (3.75, 3.0), (0.5, 3.0)), np.array([0.5, 3.0])) is None
    risk[31:44, 21:39] = 17
    assert find_way(field_of(risk, (3.75, 3.0), (0.5, 3.0)), np.array([0.5, 3.0])) is None


def test_a_robot_beside_a_wall_may_leave_but_not_pass_it():
    risk = np.full((60, 60), 17.0)
    risk[30] = IMPASSABLE
    robot = np.array([2.95, 3.0])
    assert find_way(field_of(risk, (0.5, 3.0), robot), robot)[0] < robot[0]
    risk[[0, -1]], risk[:, [0, -1]] = IMPASSABLE, IMPASSABLE
    assert find_way(field_of(risk, (5.0, 3.0), robot), robot) is None


def test_a_robot_that_slid_too_near_a_wall_is_led_off_it_on_its_own_side():
    risk = np.full((60, 60), 17.0)
    risk[30] = IMPASSABLE
    slid = np.array([2.95, 3.0])
    # Planned before it slid, so that nothing is opened around it. Both sides have a way: around the end of the wall.
    risk[30, :5] = 17
    field = field_of(risk, (5.0, 3.0), (0.5, 3.0))
    assert np.isinf(field.price[tuple(np.floor((slid - field.origin) / 0.1).astype(int))])
    assert find_way(field, slid)[0] < 2.95
    # Only the far side has one.
    risk[30, :5] = IMPASSABLE
    risk[[0, -1]], risk[:, [0, -1]] = IMPASSABLE, IMPASSABLE
    assert find_way(field_of(risk, (5.0, 3.0), (0.5, 3.0)), slid) is None


def test_a_free_cell_without_a_way_has_none_however_near_another_is():
    risk = np.full((60, 60), 17.0)
    risk[20:30, 20:30] = 136.0
    risk[22:28, 22:28] = 17.0
    inside = np.array([2.5, 2.5])
    assert find_way(field_of(risk, (5.0, 2.5), inside), inside, slack=1.0) is None


def test_a_mark_if_unseen_counts_only_where_nothing_was_seen():
    for kind, seen, blocked in ((IF_UNSEEN, 17.0, False), (IF_UNSEEN, np.nan, True), (ALWAYS, 17.0, True)):
        field = field_of(np.full((40, 40), seen), (3.5, 2.0), (0.5, 2.0), marks=np.array([[2.0, 2.0, 0.2, kind]]))
        middle = tuple(np.floor((np.array([2.0, 2.0]) - field.origin) / 0.1).astype(int))
        assert np.isinf(field.price[middle]) == blocked


def test_of_two_ways_that_cost_about_the_same_the_one_so_far_is_kept():
    before, sides = None, []
    for n in range(6):
        risk = np.full((60, 60), 17.0)
        risk[25:35, 20:40] = IMPASSABLE
        risk[25:35, [40, 41] if n % 2 else [18, 19]] = IMPASSABLE
        before = field_of(risk, (5.5, 3.0), (0.5, 3.0), before=before)
        sides.append(np.sign(find_way(before, np.array([0.5, 3.0]))[1] - 3.0))
    assert sides[0] != 0
    assert sides == [sides[0]] * 6


# The decisions


def test_the_subgoal_is_at_the_goal_when_that_is_nearer_and_v_r_falls_towards_it():
    commands = [decide(VfhState(), sight(goal=(x, 0)), pioneer(), VfhConfig())[1] for x in (5.0, 0.5, 0.2)]
    np.testing.assert_allclose([c.subgoal[0] for c in commands], [1.3, 0.5, 0.2])
    assert commands[0].v_r > commands[1].v_r > commands[2].v_r > 0


def test_it_stands_still_until_its_start_time():
    config = VfhConfig(start_time=1.0)
    state, command = decide(VfhState(), replace(sight(goal=(5.0, 0)), time=0.9), pioneer(), config)
    assert (state.status, command.v_r, command.omega_r) == ("looking", 0, 0)
    assert decide(state, replace(sight(goal=(5.0, 0)), time=1.0), pioneer(), config)[1].v_r > 0


def test_v_r_falls_with_the_risk_as_k_x_does():
    fast, slow = (
        decide(VfhState(), replace(sight(), histogram=histogram([1] * 9, risk)), pioneer(), VfhConfig())[1]
        for risk in (0.0, 30.0)
    )
    assert slow.v_r / fast.v_r == pytest.approx(1 - 30 / pioneer().risk_limit)


def test_the_paper_preset_is_the_paper_and_nothing_else():
    config = VfhConfig(preset="paper")
    state, command = decide(VfhState(), sight([0, 0, 0, 0, 0, 0, 1, 0, 0]), pioneer(), config)
    theta = np.deg2rad(40)
    np.testing.assert_allclose(command.subgoal, [1.3 * np.cos(theta), 1.3 * np.sin(theta), theta], atol=1e-6)
    assert command.v_r == pytest.approx(0.3 * pioneer().max_speed)
    assert state.status == "driving"
    state, command = decide(state, sight([0] * 9), pioneer(), config)
    assert (state.status, command.v_r, command.omega_r) == ("no way", 0, 0)


@pytest.mark.parametrize("first", [-1, 1])
def test_a_goal_behind_is_turned_to_on_one_side(first):
    goal, state, heading, sides = np.array([-5.0, 0.0]), VfhState(), 0.0, []
    for n in range(60):
        # The point to steer for moves from one side to the other, as odometry and plans do.
        way = goal + np.array([0, 0.4 * first * (-1) ** n])
        state, command = decide(state, sight(goal=goal, way=way, pose=(0, 0, heading), time=0.1 * n), pioneer(), CONFIG)
        if state.status == "driving":
            break
        assert command.v_r == 0
        sides.append(np.sign(command.omega_r))
        heading += 0.1 * command.omega_r
    assert state.status == "driving"
    assert set(sides) == {first}


def test_no_way_needs_a_look_all_around_and_several_updates_and_is_left_when_there_is_one():
    state, statuses, heading, index = VfhState(), [], 0.0, 0
    for n in range(200):
        index += n % 5 == 0
        seen = sight(way=None, index=index, pose=(0, 0, heading), time=0.1 * n)
        state, command = decide(state, seen, pioneer(), VfhConfig())
        heading += 0.1 * command.omega_r
        assert command.v_r == 0
        statuses.append(state.status)
    assert [status for status, _ in groupby(statuses)] == ["looking", "no way"]
    assert abs(heading) >= 2 * np.pi - 0.2
    for n in range(VfhConfig().confirmations + 1):
        seen = sight(index=index + 1 + n, pose=(0, 0, 0), time=20.0 + n)
        state, _ = decide(state, seen, pioneer(), VfhConfig())
    assert state.status in ("driving", "turning")


def test_before_a_goal_too_near_to_be_seen_it_backs_up_and_looks_again_before_it_says_no_way():
    state, statuses, pose, index = VfhState(), [], np.zeros(3), 0
    for n in range(400):
        index += n % 5 == 0
        seen = sight(way=None, index=index, goal=(0.6, 0.0), pose=pose, time=0.1 * n)
        state, command = decide(state, seen, pioneer(), VfhConfig())
        pose = pose + 0.1 * np.array([*command.v_r * np.array([np.cos(pose[2]), np.sin(pose[2])]), command.omega_r])
        statuses.append(state.status)
    assert [status for status, _ in groupby(statuses)] == ["looking", "backing", "looking", "no way"]
    assert np.hypot(*pose[:2]) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("downhill", [(-0.3, 0.0), (0.0, 0.3)])
def test_who_slides_when_it_turns_backs_off_a_slope_first_and_does_not_come_back(downhill):
    crawler = replace(pioneer(), turn_slide=0.7)
    behind = sight(goal=(-5.0, 0.5), downhill=downhill)
    state, command = decide(VfhState(goal=(-5.0, 0.5)), behind, crawler, CONFIG)
    assert state.status == "backing"
    assert command.v_r < 0
    assert len(state.marks) == 1
    assert state.marks[0][0] > 0.5 * crawler.footprint[0]
    # As far as it is level, then it turns.
    state, _ = decide(state, replace(behind, time=0.1), crawler, CONFIG)
    assert state.status == "backing"
    state, command = decide(state, replace(behind, time=0.2, downhill=(0.0, 0.0)), crawler, CONFIG)
    assert state.status == "turning"
    assert command.omega_r != 0
    # On a crest it was level before it turned. It backs up farther then, but not for ever where it hangs.
    statuses = []
    for time in np.arange(0.3, 6.0, 0.1):
        state, _ = decide(state, replace(behind, time=time), crawler, CONFIG)
        statuses.append(state.status)
    assert set(statuses[:35]) == {"backing"}
    assert set(statuses[-10:]) == {"turning"}
    # Who does not slide turns where it is.
    state, _ = decide(VfhState(goal=(-5.0, 0.5)), behind, pioneer(), CONFIG)
    assert state.status == "turning"


def test_who_hangs_on_a_crest_does_not_turn_and_back_up_to_and_fro_for_long():
    # It is level while it backs up and tilted as soon as it turns, and gets nowhere.
    crawler, state, turning, longest = replace(pioneer(), turn_slide=0.7), VfhState(goal=(-5.0, 0.5)), 0, 0
    for time in np.arange(0.0, 12.0, 0.1):
        downhill = (0.0, 0.0) if state.status == "backing" else (-0.3, 0.0)
        state, command = decide(state, sight(goal=(-5.0, 0.5), downhill=downhill, time=time), crawler, CONFIG)
        turning = turning + 1 if command.omega_r else 0
        longest = max(longest, turning)
    assert longest > 20


@pytest.mark.parametrize(("turned", "side"), [(0.0, -1), (10.0, 1)], ids=["at first", "to and fro"])
def test_who_has_no_room_turns_to_the_other_side_but_not_to_and_fro(turned, side):
    beside = sight(goal=(-5.0, 0.5), obstacles=np.array([[0.194, 0.194]]))
    known = {"goal": (-5.0, 0.5), "spot": (0.0, 0.0), "heading": 0.0, "anchor": (0.0, 0.0, 0.0, 0.0)}
    before = VfhState(status="turning", side=1.0, backed=True, turned=turned, **known)
    _, command = decide(before, beside, pioneer(), CONFIG)
    assert np.sign(command.omega_r) == side


def backed_up(state, pose, seconds, *, time, ability, **values):
    """State and poses (n, 3) of a unicycle that does as it is told while it backs up."""
    poses = [np.array(pose, float)]
    for n in range(round(seconds / CONFIG.period)):
        seen = sight(pose=poses[-1], time=time + n * CONFIG.period, **values)
        state, command = decide(state, seen, ability, CONFIG)
        if state.status != "backing":
            break
        poses.append(moved(poses[-1], command.v_r, command.omega_r))
    return state, np.array(poses)


def moved(pose, v, omega):
    middle = pose[2] + 0.5 * CONFIG.period * omega
    return pose + CONFIG.period * np.array([v * np.cos(middle), v * np.sin(middle), omega])


def driven(v, omega, seconds, **values):
    """State, poses (n, 3) and time after a drive along an arc from the origin."""
    state, poses, time = VfhState(), [np.zeros(3)], 0.0
    while time < seconds:
        ahead = [np.cos(poses[-1][2]), np.sin(poses[-1][2])]
        seen = sight(pose=poses[-1], time=time, way=poses[-1][:2] + ahead, **values)
        state, _ = decide(state, seen, pioneer(), CONFIG)
        poses.append(moved(poses[-1], v, omega))
        time += CONFIG.period
    return state, np.array(poses), time


@pytest.mark.parametrize("side", [1, -1])
def test_who_backs_off_a_slope_or_is_stuck_does_so_on_its_own_track_and_who_wants_room_goes_straight(side):
    goal, crawler = (0.0, 50.0 * side), replace(pioneer(), turn_slide=0.7)
    driven_state, track, time = driven(0.2, 0.2 * side, 6.0, goal=goal)
    behind = track[-1, :2] - 5 * np.array([np.cos(track[-1, 2]), np.sin(track[-1, 2])])
    here = sight(pose=track[-1], time=time, way=behind, goal=goal)
    state, _ = decide(driven_state, replace(here, downhill=(-0.3, 0.0)), crawler, CONFIG)
    _, poses = backed_up(state, track[-1], 5.0, time=time, goal=goal, downhill=(-0.3, 0.0), ability=crawler)
    assert np.hypot(*(poses[-1, :2] - poses[0, :2])) > 0.6
    off = np.linalg.norm(poses[:, None, :2] - track[None, :, :2], axis=2).min(axis=1)
    assert off.max() < 0.04
    # It looks where it looked there.
    there = np.argmin(np.linalg.norm(poses[-1, :2] - track[:, :2], axis=1))
    assert abs(wrapped(poses[-1, 2] - track[there, 2])) < 0.15
    # Stuck for a while, it turns as the track does, too.
    stuck_here = replace(here, time=time + CONFIG.stuck_time + 0.1, way=None)
    state, command = decide(replace(driven_state, anchor=(*track[-1], time)), stuck_here, crawler, CONFIG)
    assert (state.status, np.sign(command.omega_r)) == ("backing", -side)
    hanging = replace(driven_state, status="turning", side=1.0, anchor=(*track[-1], time))
    state, command = decide(hanging, stuck_here, crawler, CONFIG)
    assert (state.status, command.omega_r) == ("backing", 0)
    wall = np.column_stack([np.linspace(-0.1, 0.4, 11), np.full(11, 0.24)])
    state, command = decide(driven_state, replace(here, obstacles=np.vstack([wall, -wall])), crawler, CONFIG)
    assert (state.status, command.omega_r) == ("backing", 0)


@pytest.mark.parametrize("track", [(), ((0.5, 0.0, 0.0),), ((-0.3, 0.6, -1.0),)], ids=["none", "ahead", "beside"])
def test_without_a_track_behind_it_a_robot_backs_up_straight(track):
    backing = VfhState(
        status="backing", goal=(5.0, 0.0), back_from=(0.0, 0.0, 0.0), back_to=1.0, track=track, on_track=True
    )
    _, command = decide(backing, sight(), pioneer(), CONFIG)
    assert command.v_r < 0
    assert command.omega_r == 0


def test_a_turn_on_the_spot_ends_the_track_and_backing_up_does_not():
    track = ((-0.2, 0.0, 0.0), (-0.1, 0.0, 0.0))
    for status, kept in (("driving", (0, 3)), ("backing", (0, 2)), ("turning", (1, 1))):
        heading = 0.6 if status == "turning" else 0.0
        before = VfhState(status=status, goal=(5.0, 0.0), back_from=(0.0, 0.0, 0.0), back_to=0.0, track=track)
        state, _ = decide(before, sight(pose=(0.0, 0.0, heading)), pioneer(), CONFIG)
        assert (kept[0] == 0) == (track[0] in state.track)
        assert len(state.track) == kept[1]


def test_downhill_is_that_of_the_ground_seen_from_the_robot():
    for yaw in (0.0, 2.0):
        assert np.allclose(downhill_of(RigidTransform(RollPitchYaw(0.0, -0.3, yaw), [1, 2, 3])), [-np.sin(0.3), 0.0])
        assert np.allclose(downhill_of(RigidTransform(RollPitchYaw(0.3, 0.0, yaw), [1, 2, 3])), [0.0, -np.sin(0.3)])


def test_one_update_without_a_way_is_not_no_way():
    state = VfhState()
    for n in range(60):
        seen = sight(way=None if n % 2 else np.array([5.0, 0.0]), index=n, pose=(0.1 * n, 0, 0), time=0.1 * n)
        state, _ = decide(state, replace(seen, goal=np.array([50.0, 0.0])), pioneer(), VfhConfig())
        assert state.status != "no way"


def test_a_robot_whose_way_changes_whenever_it_faces_it_gets_away_all_the_same():
    open_field = field_of(np.full((80, 80), 17.0), (7.0, 4.0), (4.0, 4.0))
    state, heading, xy = VfhState(), 0.0, np.array([4.0, 4.0])
    ways, n = [np.array([4.0, 6.0]), np.array([4.0, 2.0])], 0
    for k in range(400):
        to_way = ways[n % 2] - xy
        # The plan says the other way as soon as the robot looks along this one.
        n += abs(wrapped(np.arctan2(to_way[1], to_way[0]) - heading)) < 0.3
        seen = sight(goal=(7, 4), way=ways[n % 2], field=open_field, index=k, pose=(*xy, heading), time=0.1 * k)
        state, command = decide(state, seen, pioneer(), CONFIG)
        heading = wrapped(heading + 0.1 * command.omega_r)
        if command.subgoal is not None:
            heading = command.subgoal[2]
            xy = xy + 0.05 * np.array([np.cos(heading), np.sin(heading)])
        if np.hypot(*(xy - 4.0)) > 0.5:
            break
    assert np.hypot(*(xy - 4.0)) > 0.5


def test_a_way_that_is_kept_to_is_let_go_at_its_point_though_that_is_near_where_it_turned():
    field = field_of(np.full((80, 80), 17.0), (7.0, 4.0), (4.0, 4.0))
    kept = VfhState(goal=(7.0, 4.0), held=(4.35, 4.0), spot=(4.0, 4.0), turned=10.0, heading=0.0)
    for x, held in ((4.1, 4.35), (4.3, np.nan)):
        state, _ = decide(kept, sight(goal=(7, 4), field=field, pose=(x, 4, 0)), pioneer(), CONFIG)
        np.testing.assert_equal(state.held[0], held)
    assert state.turned == 0


def test_who_is_told_to_drive_and_does_not_move_backs_up_and_marks_what_is_ahead():
    state = VfhState()
    for n in range(60):
        state, command = decide(state, sight(time=0.1 * n), pioneer(), VfhConfig())
        if state.status == "backing":
            break
    assert command.v_r < 0
    assert 4.0 <= 0.1 * n < 4.5
    ((x, y, _, kind),) = state.marks
    assert 0.2 < x < 0.6
    assert abs(y) < 0.05
    assert kind == ALWAYS


def turned_by(rate, told, *, time=1.5):
    """State and command after a drive ahead of so long at a yaw rate [rad/s], told another."""
    state, command = decide(VfhState(), sight(yaw_rate=told), pioneer(), CONFIG)
    for n in range(1, round(time / CONFIG.period)):
        pose, now = (0.3 * n * CONFIG.period, 0.0, rate * n * CONFIG.period), n * CONFIG.period
        ahead = np.array([pose[0] + np.cos(pose[2]), np.sin(pose[2])])
        seen = sight(time=now, pose=pose, way=ahead, yaw_rate=told)
        state, command = decide(state, seen, pioneer(), CONFIG)
        if command.v_r <= 0:
            break
    return state, command


@pytest.mark.parametrize("side", [1, -1])
def test_who_is_turned_without_being_told_to_backs_up_and_marks_that_side(side):
    state, command = turned_by(0.8 * side, 0.0)
    assert (state.status, state.on_track) == ("backing", True)
    assert command.v_r < 0
    ((x, y, _, kind),) = state.marks
    away = np.array([x, y]) - [state.back_from[0], 0.0]
    heading = state.heading
    across = away @ [-np.sin(heading), np.cos(heading)]
    assert kind == ALWAYS
    assert across * side == pytest.approx(pioneer().footprint[1] / 2)
    assert turned_by(0.8 * side, -0.8 * side)[0].status == "backing"


@pytest.mark.parametrize(("rate", "told"), [(0.8, 0.8), (0.4, 0.8), (0.0, 0.8), (0.15, 0.0), (0.8, np.nan)])
def test_who_turns_as_told_or_less_or_a_little_astray_drives_on(rate, told):
    state, command = turned_by(rate, told)
    assert state.status == "driving"
    assert command.v_r > 0
    assert not state.marks


def test_arrived_stays_so_when_pushed_a_little_and_not_when_the_goal_moves():
    config = VfhConfig(tolerance=0.2)
    state, command = decide(VfhState(), sight(goal=(0.19, 0)), pioneer(), config)
    assert (state.status, command.v_r, command.omega_r) == ("arrived", 0, 0)
    state, _ = decide(state, sight(goal=(0.19, 0), pose=(-0.15, 0, 0)), pioneer(), config)
    assert state.status == "arrived"
    state, _ = decide(state, sight(goal=(4, 0)), pioneer(), config)
    assert state.status == "driving"


# The whole chain


def test_the_robot_drives_to_a_goal_on_open_ground_and_stays_there():
    result = run([], (3.0, 1.0), duration=15, until=())
    assert result.statuses[-1] == "arrived"
    assert np.hypot(*(result.poses[-1, :2] - (3, 1))) < 0.2
    np.testing.assert_allclose(result.poses[-1], result.poses[-20], atol=1e-6)


@pytest.mark.parametrize(
    ("boxes", "goal", "start", "noise"),
    [
        (U_SHAPE, (6, 0), (2, 0, 0), 0.0),
        (U_SHAPE, (6, 0), (2, 0, 0), 0.01),
        (CORRIDOR, (6, 0), (0, 0, 0), 0.005),
        (TWO_GAPS, (5, 0), (0, 0, 0), 0.005),
        ([], (-3, 0), (0, 0, 0), 0.0),
        ([(2.5, -1, 2.7, 1)], (2.1, 0), (0, 0, 0), 0.0),
    ],
    ids=["dead end", "dead end, noise", "corridor with a pillar", "two equal gaps", "goal behind", "goal at a wall"],
)
def test_the_goal_is_reached_without_touching_anything(boxes, goal, start, noise):
    result = run(boxes, goal, start=start, noise=noise)
    assert result.statuses[-1] == "arrived"
    assert not result.touched
    assert len(turns(result)) <= 4


def test_a_pillar_in_a_corridor_is_passed_inside_the_corridor():
    result = run(CORRIDOR, (6, 0))
    assert np.abs(result.poses[:, 1]).max() < 0.8


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_closed_room_ends_with_no_way_after_a_look_around(noise):
    result = run(ROOM, (5, 0), noise=noise)
    assert result.statuses[-1] == "no way"
    assert "looking" in result.statuses
    assert not result.touched


def test_a_goal_inside_a_block_ends_with_no_way():
    result = run([(2, -1, 3.5, 1)], (2.7, 0))
    assert result.statuses[-1] == "no way"
    assert not result.touched


def test_an_obstacle_that_is_not_seen_is_backed_off_and_gone_around():
    result = run([], (5, 0), unseen=[(2, -0.3, 2.3, 0.3)])
    assert "backing" in result.statuses
    assert result.statuses[-1] == "arrived"


def test_without_a_memory_a_closed_room_is_not_left_nor_touched():
    result = run(ROOM, (5, 0), memory=False, duration=30)
    assert result.statuses[-1] == "no way"
    assert not result.touched


# The ports


def controller(**values):
    system = FuzzyVfhController(pioneer())
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    features = describe_terrain(scan([], np.zeros(3)), TerrainConfig())
    given = {
        "histogram": AbstractValue.Make(make_histogram(features, np.full(9, 0.06), pioneer())),
        "X_MB": RigidTransform(),
        "goal": [3.0, 0.0],
    } | values
    for name, value in given.items():
        system.GetInputPort(name).FixValue(context, value)
    return system, simulator, context


def test_the_ports_say_where_to_how_fast_and_at_what_risk():
    system, simulator, context = controller()
    assert system.GetOutputPort("status").Eval(context) == "looking"
    np.testing.assert_allclose(system.GetOutputPort("reference_twist").Eval(context), 0)
    simulator.AdvanceTo(0.05)
    assert system.GetOutputPort("status").Eval(context) == "driving"
    np.testing.assert_allclose(system.GetOutputPort("reference_pose").Eval(context), [1.3, 0, 0], atol=1e-6)
    assert system.GetOutputPort("risk").Eval(context)[0] == pytest.approx(1 / 0.06)
    assert 0 < system.GetOutputPort("reference_twist").Eval(context)[0] < pioneer().max_speed


@pytest.mark.parametrize("goal", [[np.nan, 0.0], [0.0, np.inf]])
def test_a_goal_that_is_not_finite_is_named(goal):
    _, simulator, _ = controller(goal=goal)
    with pytest.raises(PortError, match=r"FuzzyVfhController\.goal: not finite"):
        simulator.AdvanceTo(0.05)


def test_a_memory_of_another_type_is_named():
    _, simulator, _ = controller(risk_memory=AbstractValue.Make(object()))
    with pytest.raises(
        PortError, match=r"FuzzyVfhController\.risk_memory: wrong type, got 'object' \(valid: RiskGrid\)"
    ):
        simulator.AdvanceTo(0.05)


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (VfhConfig(preset="best"), r"vfh: preset: unknown value, got 'best' \(valid: full, paper\)"),
        (VfhConfig(tolerance=0.0), r"vfh: tolerance: out of range"),
        (VfhConfig(wavefront=WavefrontConfig(unknown_price=0.5)), r"vfh: wavefront\.unknown_price: out of range"),
    ],
)
def test_bad_configurations_name_the_key(config, message):
    with pytest.raises(ConfigError, match=message):
        FuzzyVfhController(pioneer(), config)


def test_risk_rises_near_what_stands_ahead_or_beside_and_not_behind():
    size = [0.6, 0.4]
    pillar = np.array([[0.5, 0.4]])
    assert nearness(np.zeros((0, 2)), 0.0, size, 0.5) == 0
    assert nearness(np.array([[0.2, 0.2]]), 0.0, size, 0.5) == pytest.approx(1.0)
    assert nearness(pillar, 0.0, size, 0.5) == pytest.approx((1 - np.hypot(0.2, 0.2) / 0.5) ** 2)
    assert nearness(-pillar, 0.0, size, 0.5) == 0
    # Turned away from it, the robot passes farther off; towards it, it is straight ahead.
    assert nearness(pillar, -0.6, size, 0.5) < nearness(pillar, 0.0, size, 0.5)
    ahead = nearness(pillar, float(np.arctan2(0.4, 0.5)), size, 0.5)
    assert ahead == pytest.approx((1 - (np.hypot(0.5, 0.4) - 0.3) / 0.5) ** 2)
    risks, speeds = [], []
    for distance in (2.0, 0.25, 0.2):
        beside = replace(sight(goal=(5.0, 0)), obstacles=np.array([[0.3, distance]]))
        command = decide(VfhState(), beside, pioneer(), VfhConfig())[1]
        risks.append(command.risk)
        speeds.append(command.v_r)
    assert risks == sorted(risks)
    assert speeds == sorted(speeds, reverse=True)
    assert speeds[2] < speeds[1] < speeds[0]
