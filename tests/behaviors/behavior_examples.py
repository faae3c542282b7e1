"""Examples of the behaviours for the contract test."""

import numpy as np
from naraha.systems.behaviors import (
    BehaviorCoordinator,
    FuzzyGoalSeeking,
    FuzzyObstacleAvoidance,
    MeasuringTour,
    MeasuringTourConfig,
    read_behaviors,
)
from naraha.systems.sensing import Scan
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform
from pydrake.systems.framework import LeafSystem, System

from tests.behaviors.cluttered_room import BEHAVIORS
from tests.routes.route_examples import with_inputs


def random_scan(seed: int) -> Scan:
    points = np.random.default_rng(seed).uniform([-4, -4, 0], [4, 4, 0], (60, 3))
    return Scan(PointCloud(points.astype(np.float32)), 0.0, 0.1, 0)


def goal_seeking(seed: int) -> tuple[System, LeafSystem]:
    rules = read_behaviors(BEHAVIORS).goal_seeking
    return with_inputs(FuzzyGoalSeeking(rules), X_MB=RigidTransform([0.1 * seed, 0, 0]), goal=np.array([3.0, 1.0]))


def obstacle_avoidance(seed: int) -> tuple[System, LeafSystem]:
    system = FuzzyObstacleAvoidance(read_behaviors(BEHAVIORS).obstacle_avoidance)
    inputs = {"scan_S": random_scan(seed), "X_BS": RigidTransform([0.1, 0, 0.3])}
    return with_inputs(system, **inputs, goal_error=np.array([3.0, 0.4]))


def coordination(seed: int) -> tuple[System, LeafSystem]:
    behaviors = read_behaviors(BEHAVIORS)
    return with_inputs(
        BehaviorCoordinator(behaviors.coordinator, behaviors.obstacle_avoidance.directions()),
        goal_twist=np.array([0.8, 0.1]),
        avoidance_twist=np.array([0.2, -0.7]),
        goal_error=np.array([3.0, 0.4]),
        free_ways=np.random.default_rng(seed).uniform(0.2, 2.5, 5),
        scan_S=random_scan(seed),
        X_BS=RigidTransform([0.1, 0, 0.3]),
    )


def measuring_tour(seed: int) -> tuple[System, LeafSystem]:
    route = np.array([[2.0, 0.0], [4.0, 0.1 * seed]])
    tour = MeasuringTour(MeasuringTourConfig(), route, np.array([1]))
    return with_inputs(tour, X_MB=RigidTransform([1.0, 0, 0]), illuminance=np.array([120.0 + seed]))


BEHAVIOR_EXAMPLES = {
    "BehaviorCoordinator": coordination,
    "FuzzyGoalSeeking": goal_seeking,
    "FuzzyObstacleAvoidance": obstacle_avoidance,
    "MeasuringTour": measuring_tour,
}
