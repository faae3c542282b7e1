"""Fuzzy behaviours of a mobile robot and their coordination (row S4-g)."""

from .behavior_coordinator import BehaviorCoordinator, CoordinatorConfig, blend, perceive, update_weights
from .behavior_files import Behaviors, read_behaviors
from .free_way import braked, free_arc, free_ways
from .fuzzy_goal_seeking import FuzzyGoalSeeking, goal_error
from .fuzzy_obstacle_avoidance import AvoidanceConfig, FuzzyObstacleAvoidance
from .fuzzy_rules import FuzzyRule, FuzzyRules, RuleBase
from .measuring_tour import Measurement, MeasuringTour, MeasuringTourConfig, TourState, tour_step

__all__ = [
    "AvoidanceConfig",
    "BehaviorCoordinator",
    "Behaviors",
    "CoordinatorConfig",
    "FuzzyGoalSeeking",
    "FuzzyObstacleAvoidance",
    "FuzzyRule",
    "FuzzyRules",
    "Measurement",
    "MeasuringTour",
    "MeasuringTourConfig",
    "RuleBase",
    "TourState",
    "blend",
    "braked",
    "free_arc",
    "free_ways",
    "goal_error",
    "perceive",
    "read_behaviors",
    "tour_step",
    "update_weights",
]
