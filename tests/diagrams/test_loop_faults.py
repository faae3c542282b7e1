"""The loop when things go wrong: somebody takes over, the link is lost, ways close, goals cannot be reached."""

import numpy as np
import open3d as o3d
import pytest
from naraha.diagrams.survey_loop import LoopStages
from naraha.systems.routes import (
    RouteGrid,
    RouteLearnerConfig,
    SurveyLoopConfig,
    VoxelWorldConfig,
    read_routes,
    write_routes,
)
from naraha.systems.routes.frontiers import FrontierConfig
from naraha.systems.routes.route_files import RouteFileError
from open3d.t.geometry import PointCloud

from tests.diagrams.loop_rig import LoopRig
from tests.routes.route_examples import floor_with_pool

START = (-3.0, 0.0, 0.0)


def stages(**survey):
    looks = FrontierConfig(look_time=2.0, min_gain=1.0, min_value=0.0)
    return LoopStages(
        max_step=0.12,
        survey=SurveyLoopConfig(frontiers=looks, **survey),
        world=VoxelWorldConfig(period=1.0),
        # Slow enough to be interrupted.
        learner=RouteLearnerConfig(steps_per_update=20_000),
    )


def with_block(cloud: PointCloud, x0: float, x1: float, y0: float, y1: float) -> PointCloud:
    """`cloud` with a block of 0.6 m height in it."""
    x, y, z = np.meshgrid(np.arange(x0, x1, 0.05), np.arange(y0, y1, 0.05), np.arange(0.0, 0.6, 0.05))
    block = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    points = np.vstack([cloud.point.positions.numpy(), block]).astype(np.float32)
    label = np.concatenate([cloud.point["label"].numpy().ravel(), np.zeros(len(block), np.uint8)])
    joined = PointCloud(o3d.core.Tensor(points))
    joined.point["label"] = o3d.core.Tensor(label[:, None])
    return joined


class GivenCloud:
    """A map that is known from the beginning, and can be replaced."""

    def __init__(self, cloud):
        self.cloud = cloud

    def __call__(self, stood, time):
        return self.cloud


@pytest.fixture(scope="module")
def hall():
    return floor_with_pool(spacing=0.08)


def rig_in(cloud, **survey) -> LoopRig:
    known = GivenCloud(cloud)
    rig = LoopRig(known, stages(**survey), START)
    rig.known = known
    return rig


def driven(rig, seconds, step=0.1):
    """How far the robot moves [m] in the next seconds."""
    before = rig.pose[:2]
    for _ in range(round(seconds / step)):
        rig.step(step)
    return float(np.hypot(*(rig.pose[:2] - before)))


def test_the_survey_of_a_hall_that_is_known_to_the_lidar_goes_round_the_pool_and_home(hall):
    rig = rig_in(hall)
    state = rig.until("done", limit=600)
    assert state.returned
    assert state.reason == "nothing reachable is unseen"
    assert state.legs >= 3
    assert np.hypot(*(rig.pose[:2] - START[:2])) < 0.5


def test_the_operator_takes_over_in_mid_leg_and_gives_back(hall):
    rig = rig_in(hall)
    rig.until("drive")
    rig.step(2.0)
    legs, views = rig.state.legs, rig.state.views
    heading = rig.pose[2]
    for _ in range(30):
        rig.operator.drive(0.0, 0.5)
        rig.step(0.1)
    assert rig.read("mode_switch.mode") == "teleoperation"
    assert rig.state.phase == "held"
    assert abs(np.angle(np.exp(1j * (rig.pose[2] - heading - 1.5)))) < 0.1
    rig.operator.give_back()
    rig.step(0.5)
    assert rig.state.phase != "held"
    assert rig.state.held == 1
    # What was the goal is still to be looked at, and the survey goes on to its end.
    assert rig.state.views == views
    state = rig.until("done", limit=600)
    assert state.returned
    assert state.legs > legs


def test_a_lost_link_stops_the_robot_where_it_is_until_it_is_there_again(hall):
    rig = rig_in(hall)
    rig.until("drive")
    rig.operator.drive(0.2, 0.0)
    moved = driven(rig, 0.5)
    assert moved == pytest.approx(0.1, abs=0.03)
    driven(rig, 0.2)
    assert driven(rig, 3.0) < 0.02
    assert rig.read("mode_switch.mode") == "stop"
    assert "lost" in rig.read("mode_switch.reason")
    rig.operator.drive(0.2, 0.0)
    assert driven(rig, 0.4) > 0.05
    rig.operator.give_back()
    assert rig.until("drive").held == 1


def test_stop_stops_in_mid_leg(hall):
    rig = rig_in(hall)
    rig.until("drive")
    rig.step(3.0)
    rig.operator.stop()
    assert driven(rig, 2.0) < 0.02
    assert rig.state.phase == "held"


def test_a_new_obstacle_on_the_route_closes_it_and_another_way_is_driven(hall):
    rig = rig_in(hall)
    while True:
        state = rig.until("drive", limit=600)
        if state.route.length_m > 2.0:
            break
        rig.until("choose", "look", "face", "done")
    x, y = state.route.at(state.route.length_m - 0.7)[:2]
    rig.known.cloud = with_block(hall, x - 0.1, x + 0.1, y - 0.1, y + 0.1)
    rig.step(2.5)
    assert rig.state.closed == state.closed + 1
    state = rig.until("done", limit=900)
    assert state.returned


def test_a_goal_behind_a_wall_is_never_driven_to(hall):
    wall = with_block(hall, 1.0, 1.1, -3.0, 3.0)
    rig = rig_in(wall)
    farthest = rig.pose[0]
    while rig.state.phase != "done":
        rig.step(0.5)
        farthest = max(farthest, rig.pose[0])
        assert rig.time < 600
    assert rig.state.returned
    assert farthest < 1.0 - 0.5


def test_a_robot_that_is_walled_in_says_that_there_is_no_way_home(hall):
    rig = rig_in(hall, most_failures=2)
    rig.until("drive")
    while rig.pose[0] < -1.6:
        rig.operator.drive(0.3, 0.0)
        rig.step(0.1)
    rig.known.cloud = with_block(hall, -2.3, -2.2, -3.0, 3.0)
    rig.operator.give_back()
    state = rig.until("done", limit=300)
    assert not state.returned
    assert "no way home" in state.reason


def test_learning_that_is_interrupted_goes_on_from_what_was_learnt(hall):
    rig = rig_in(hall, settle_time=0.0)
    rig.until("learn")
    rig.step(0.1)
    while rig.read("learner.learning").steps == 0:
        rig.step(0.1)
    before = rig.read("learner.learning").steps
    rig.operator.stop()
    rig.step(0.3)
    assert rig.state.phase == "held"
    rig.operator.give_back()
    rig.until("learn")
    rig.step(0.3)
    assert rig.read("learner.learning").steps > before or rig.read("learner.learning").certified


def test_routes_of_another_map_are_refused(hall, tmp_path):
    rig = rig_in(hall)
    rig.until("offer")
    grid, routes = rig.read("world.route_grid"), rig.state.offers
    write_routes(tmp_path / "routes.csv", routes, grid)
    again = read_routes(tmp_path / "routes.csv", grid)
    np.testing.assert_allclose(again[0].xy, routes[0].xy, atol=1e-3)
    other = RouteGrid.from_kind(grid.kind, grid.cell, grid.origin + 0.5)
    with pytest.raises(RouteFileError, match="map"):
        read_routes(tmp_path / "routes.csv", other)
