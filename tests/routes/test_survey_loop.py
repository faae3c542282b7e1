from dataclasses import replace

import numpy as np
import pytest
from naraha.systems.errors import ConfigError
from naraha.systems.routes import FREE, OCCUPIED, RouteGrid, SurveyLoop, SurveyLoopConfig, Voxels, find_routes
from naraha.systems.routes.frontiers import FrontierConfig
from naraha.systems.routes.survey_state import LoopState, Surroundings
from naraha.systems.routes.survey_steps import climbs, next_state

CONFIG = SurveyLoopConfig(
    frontiers=FrontierConfig(view_range=2.0, near_range=0.0, fov_deg=120, min_gain=0.5, min_value=0.0, look_time=1.0)
)


def hall(block=()):
    """Grid and voxels of a hall of 8 m × 5 m within walls; `block` (i0, i1, j0, j1) are further cells that are full."""
    kind = np.full((80, 50), FREE, np.uint8)
    kind[[0, -1]] = kind[:, [0, -1]] = OCCUPIED
    for i0, i1, j0, j1 in block:
        kind[i0:i1, j0:j1] = OCCUPIED
    walls = np.argwhere(kind == OCCUPIED)
    index = np.column_stack([walls, np.full(len(walls), 5)])
    return RouteGrid.from_kind(kind, 0.1), Voxels(index, np.full(len(index), OCCUPIED, np.uint8), 0.1)


class Robot:
    """Drives every route to its end at once and turns at once; keeps what the loop went through."""

    def __init__(self, world=None, config=CONFIG, pose=(1.0, 1.0, 0.0)):
        self.grid, self.voxels = world or hall()
        self.config, self.pose, self.now = config, np.array(pose), 0.0
        self.state, self.phases, self.choice, self.driving = LoopState(), [], -1, "arrived"

    def step(self, period=1.0):
        self.now += period
        state = self.state
        if state.phase == "drive" and self.driving == "arrived":
            self.pose = np.array([*state.goal, self.pose[2]])
        if state.phase == "face":
            self.pose[2] = state.view.heading
        here = Surroundings(
            self.pose, self.grid, self.voxels, "certified", self.routes, self.driving, choice=self.choice
        )
        self.state = next_state(state, self.now, here, self.config)
        self.phases.append(self.state.phase)
        return self.state

    def routes(self):
        return find_routes(self.grid, np.array(self.state.start), np.array(self.state.goal))

    def until(self, phase, steps=600):
        for _ in range(steps):
            if self.step().phase == phase:
                return self.state
        raise AssertionError(f"never {phase}: {self.phases[-10:]}")


def test_a_survey_of_a_hall_looks_at_all_of_it_and_comes_home():
    robot = Robot()
    state = robot.until("done")
    assert state.returned
    assert state.reason == "nothing reachable is unseen"
    assert state.legs >= 3
    assert np.hypot(*(robot.pose[:2] - [1.0, 1.0])) < 0.6


def test_the_loop_waits_for_a_map():
    robot = Robot()
    robot.grid = RouteGrid.from_kind(np.full((1, 1), OCCUPIED, np.uint8), 0.1)
    assert all(robot.step().phase == "wait" for _ in range(10))


def test_a_robot_that_is_late_goes_home_and_says_why():
    robot = Robot(config=replace(CONFIG, time_budget=30.0))
    state = robot.until("done")
    assert state.returned
    assert state.reason == "the time budget is over"


def test_at_the_prompt_nothing_is_driven_until_the_operator_chooses():
    robot = Robot(config=replace(CONFIG, operator="prompt"))
    robot.until("offer")
    assert all(robot.step().phase == "offer" for _ in range(20))
    robot.choice = 99
    assert robot.step().phase == "offer"
    robot.choice = 0
    state = robot.step()
    assert state.phase == "drive"
    assert state.chosen == 0


def test_auto_takes_the_cheapest_route():
    robot = Robot()
    state = robot.until("drive")
    assert state.offers[state.chosen].cost == min(route.cost for route in state.offers)


def test_a_route_that_a_newer_map_closes_is_given_up_and_chosen_anew():
    robot = Robot(pose=(1.0, 2.5, 0.0))
    robot.driving = "driving"
    state = robot.until("drive")
    middle = robot.grid.index_of(state.route.at(0.8 * state.route.length_m)[:2])
    i, j = middle
    robot.grid, robot.voxels = hall(block=[(i - 2, i + 3, j - 2, j + 3)])
    after = robot.step()
    assert after.phase == "choose"
    assert after.closed == 1
    assert len(after.route.xy) == 0


def test_a_wall_behind_the_robot_does_not_close_its_route():
    robot = Robot(pose=(1.0, 2.5, 0.0))
    robot.driving = "driving"
    state = robot.until("drive")
    robot.pose[:2] = state.route.at(state.route.length_m - 0.2)[:2]
    i, j = robot.grid.index_of(state.route.at(0.0)[:2])
    robot.grid, robot.voxels = hall(block=[(i - 1, i + 2, j - 1, j + 2)])
    assert robot.step().phase == "drive"


def test_a_goal_without_a_way_is_not_tried_again():
    robot = Robot()
    robot.until("learn")
    given_up = robot.state.view
    robot.routes = lambda: ()
    state = robot.until("choose")
    assert given_up in state.views
    assert state.failures == 1


def test_a_survey_without_any_way_ends_and_says_so():
    robot = Robot(pose=(1.0, 1.0, 0.0))
    robot.until("drive")
    robot.until("choose")
    robot.pose[:2] = [6.0, 4.0]
    robot.routes = lambda: ()
    state = robot.until("done")
    assert not state.returned
    assert state.reason.endswith("no way home")


def test_a_robot_carried_off_its_path_chooses_anew():
    robot = Robot()
    robot.driving = "off the route"
    robot.until("drive")
    assert robot.until("choose").failures == 1


def test_a_robot_that_is_caught_goes_back_and_chooses_anew():
    robot = Robot()
    robot.driving = "driving"
    robot.until("drive")
    goal = robot.state.view
    state = robot.until("back", steps=20)
    assert state.stalled == 1
    assert goal in state.views
    assert robot.until("choose", steps=10).failures == 1


def test_flippers_climb_before_a_rise_and_not_on_the_flat():
    grid, _ = hall()
    height = np.maximum(np.arange(80)[:, None] * 0.1 - 3.0, 0) * 0.5 * np.ones((80, 50))
    steep = RouteGrid.from_kind(grid.kind, 0.1, height=height)
    route = find_routes(steep, np.array([1.0, 2.5, 0.0]), np.array([6.0, 2.5]))[0]
    assert not climbs(route, 0.5, CONFIG)
    assert climbs(route, 2.5, CONFIG)


def test_an_unknown_operator_is_refused():
    with pytest.raises(ConfigError, match="operator"):
        SurveyLoop(SurveyLoopConfig(operator="nobody"))
