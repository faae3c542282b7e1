"""The behaviours together: weights, blending, the systems on their ports, and drives through rooms."""

import numpy as np
import pytest
from naraha.systems.behaviors import (
    AvoidanceConfig,
    BehaviorCoordinator,
    CoordinatorConfig,
    FuzzyGoalSeeking,
    FuzzyObstacleAvoidance,
    blend,
    free_ways,
    goal_error,
    perceive,
    read_behaviors,
    update_weights,
)
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.sensing import Scan
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator

from tests.behaviors.cluttered_room import BEHAVIORS, Robot, Room, random_room
from tests.routes.route_examples import with_inputs

CONFIG = CoordinatorConfig()


def scan_of(points, index=0):
    cloud = PointCloud(np.column_stack([points, np.zeros(len(points))]).astype(np.float32))
    return Scan(cloud, 0.0, 0.1, index)


def test_the_goal_error_is_what_the_robot_sees():
    np.testing.assert_allclose(goal_error(np.array([1.0, 1.0, np.pi / 2]), np.array([1.0, 3.0])), [2.0, 0.0])
    np.testing.assert_allclose(goal_error(np.array([1.0, 1.0, np.pi]), np.array([1.0, 3.0])), [2.0, -np.pi / 2])
    np.testing.assert_allclose(goal_error(np.array([1.0, 1.0, 2.0]), np.array([1.0, 1.0])), [0.0, 0.0])


DIRECTIONS = AvoidanceConfig().directions()


def test_danger_grows_as_the_way_to_the_goal_gets_short_and_faster_than_beside_it():
    def danger(*ways, distance=10.0, bearing=0.0):
        return perceive(np.array(ways), DIRECTIONS, np.array([distance, bearing]), CONFIG)[0]

    assert danger(2.5, 2.5, 2.5, 2.5, 2.5) == 0
    ahead = [danger(2.5, 2.5, way, 2.5, 2.5) for way in (1.4, 0.9, 0.3, 0.0)]
    assert np.all(np.diff(ahead[:3]) > 0)
    assert ahead[2:] == [1.0, 1.0]
    assert danger(0.4, 2.5, 2.5, 2.5, 2.5) < danger(2.5, 2.5, 0.4, 2.5, 2.5)
    # What counts is the way to the goal: the same obstacle is ahead, and the goal to the left.
    assert danger(2.5, 2.5, 0.5, 2.5, 2.5, bearing=2.0) < 0.5 * danger(2.5, 2.5, 0.5, 2.5, 2.5)
    # Before the obstacle there is the goal.
    assert danger(2.5, 2.5, 0.8, 2.5, 2.5, distance=0.4) == 0
    np.testing.assert_allclose(perceive(np.full(5, 0.7), DIRECTIONS, np.array([10.0, 0.3]), CONFIG).sum(), 1.0)


def test_weights_move_by_the_gains_and_stay_within_their_limits():
    weights = np.array([0.5, 0.5])
    safe = update_weights(weights, np.array([0.0, 1.0]), CONFIG)
    np.testing.assert_allclose(safe, weights + 0.1 * np.array([CONFIG.goal_gains[1], CONFIG.avoidance_gains[1]]))
    for _ in range(20):
        weights = update_weights(weights, np.array([1.0, 0.0]), CONFIG)
    np.testing.assert_allclose(weights, [CONFIG.min_weight, CONFIG.max_weight])


def test_the_blend_is_the_weighted_mean_within_the_limits():
    twists = np.array([[0.4, 0.2], [0.2, -0.6]])
    np.testing.assert_allclose(blend(np.array([1.0, 3.0]), twists, CONFIG), [0.25, -0.4])
    np.testing.assert_allclose(blend(np.array([1.0, 1.0]), np.array([[-1.0, 9.0], [-1.0, 9.0]]), CONFIG), [0.0, 1.0])


def test_the_systems_compute_what_the_functions_say():
    behaviors = read_behaviors(BEHAVIORS)
    X_MB = RigidTransform(RollPitchYaw(0, 0, 0.5), [1.0, 2.0, 0.1])
    root, seeking = with_inputs(FuzzyGoalSeeking(behaviors.goal_seeking), X_MB=X_MB, goal=np.array([4.0, 2.0]))
    context = seeking.GetMyContextFromRoot(root.CreateDefaultContext())
    error = seeking.GetOutputPort("goal_error").Eval(context)
    np.testing.assert_allclose(error, [3.0, -0.5])
    assert seeking.GetOutputPort("twist").Eval(context)[1] < 0

    # A box ahead and left in the frame of a laser that looks to the left.
    points = np.array([[0.0, -0.9], [0.1, -0.9]])
    X_BS = RigidTransform(RollPitchYaw(0, 0, np.pi / 2), [0.1, 0.0, 0.4])
    avoidance = FuzzyObstacleAvoidance(behaviors.obstacle_avoidance)
    root, avoidance = with_inputs(avoidance, scan_S=scan_of(points), X_BS=X_BS, goal_error=np.array([3.0, 1.0]))
    context = avoidance.GetMyContextFromRoot(root.CreateDefaultContext())
    in_base = np.array([[1.0, 0.0], [1.0, 0.1]])
    config = behaviors.obstacle_avoidance
    expected = free_ways(in_base, np.deg2rad(config.directions_deg), config.radius, config.reach)
    np.testing.assert_allclose(avoidance.GetOutputPort("free_ways").Eval(context), expected, atol=1e-6)


def coordinator(scan, *, stop=0.0, ways=2.5):
    twist = np.array([0.8, 0.1])
    system = BehaviorCoordinator(CONFIG, DIRECTIONS)
    inputs = {"goal_twist": twist, "avoidance_twist": np.array([0.0, 1.0]), "goal_error": np.array([5.0, 0.0])}
    root, system = with_inputs(
        system, **inputs, free_ways=np.full(5, ways), scan_S=scan, X_BS=RigidTransform(), stop=np.array([stop])
    )
    simulator = Simulator(root)
    simulator.AdvanceTo(0.5)
    return system.GetOutputPort("twist_command").Eval(system.GetMyContextFromRoot(simulator.get_context()))


def test_the_coordinator_drives_when_it_sees_and_stands_when_it_does_not_or_must():
    free = scan_of(np.array([[20.0, 0.0]]))
    assert coordinator(free)[0] > 0.7
    np.testing.assert_array_equal(coordinator(scan_of(np.zeros((0, 2)), index=-1)), [0, 0])
    np.testing.assert_array_equal(coordinator(scan_of(np.zeros((0, 2)))), [0, 0])
    np.testing.assert_array_equal(coordinator(free, stop=1.0), [0, 0])


def test_whatever_the_behaviours_want_it_stops_before_what_it_would_touch():
    blocked = coordinator(scan_of(np.array([[0.3, 0.0]])))
    assert blocked[0] == 0
    assert abs(blocked[1]) > 0


def test_bad_values_and_ports_are_refused():
    with pytest.raises(ConfigError, match="goal_gains: wrong length"):
        BehaviorCoordinator(CoordinatorConfig(goal_gains=[1.0]), DIRECTIONS)
    with pytest.raises(ConfigError, match="safe_way: out of range"):
        BehaviorCoordinator(CoordinatorConfig(safe_way=0.2), DIRECTIONS)
    with pytest.raises(ConfigError, match="directions: directions"):
        BehaviorCoordinator(CONFIG, DIRECTIONS[::-1])
    avoidance = FuzzyObstacleAvoidance(read_behaviors(BEHAVIORS).obstacle_avoidance)
    context = avoidance.CreateDefaultContext()
    with pytest.raises(PortError, match="scan_S: input port is not connected"):
        avoidance.GetOutputPort("free_ways").Eval(context)
    avoidance.GetInputPort("scan_S").FixValue(context, AbstractValue.Make(["a scan"]))
    with pytest.raises(PortError, match="scan_S: wrong type"):
        avoidance.GetOutputPort("free_ways").Eval(context)


@pytest.mark.parametrize("seed", [0, 3, 4])
def test_it_arrives_in_cluttered_rooms_without_touching_anything(seed):
    room = random_room(seed)
    assert len(room.polygons) >= 10
    drive = Robot(read_behaviors(BEHAVIORS)).drive(room, seed=seed)
    assert drive.arrived
    assert drive.clearance > 0.05


def test_a_wall_in_the_way_to_the_goal_is_never_hit():
    """Nothing leads to the goal: the robot neither arrives nor touches."""
    wall = np.array([[4.0, -1.0], [4.2, -1.0], [4.2, 9.0], [4.0, 9.0]])
    room = Room(np.array([8.0, 6.0]), [wall], np.array([1.0, 3.0, 0.0]), np.array([7.0, 3.0]))
    drive = Robot(read_behaviors(BEHAVIORS)).drive(room, duration=30.0)
    assert not drive.arrived
    assert drive.clearance > 0.02
