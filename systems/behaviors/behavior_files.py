"""The behaviours of a robot as one YAML file."""

from dataclasses import dataclass, field
from pathlib import Path

from ..config_files import read_config
from .behavior_coordinator import CoordinatorConfig
from .fuzzy_goal_seeking import GOAL_INPUTS
from .fuzzy_obstacle_avoidance import AVOIDANCE_INPUTS, AvoidanceConfig
from .fuzzy_rules import FuzzyRules, RuleBase


@dataclass(kw_only=True)
class Behaviors:
    """What a robot wants and how it weighs it."""

    goal_seeking: FuzzyRules = field(default_factory=FuzzyRules)
    obstacle_avoidance: AvoidanceConfig = field(default_factory=AvoidanceConfig)
    coordinator: CoordinatorConfig = field(default_factory=CoordinatorConfig)


def read_behaviors(path: Path) -> Behaviors:
    """Reads and checks the behaviours of a robot.

    Raises:
        ConfigError: no such file, not YAML, an unknown key, a value out of range, or rules that are none.
    """
    behaviors = read_config(path, Behaviors, "not behaviours")
    RuleBase(behaviors.goal_seeking, GOAL_INPUTS, 2, where=path, key="goal_seeking")
    RuleBase(behaviors.obstacle_avoidance.rules, AVOIDANCE_INPUTS, 2, where=path, key="obstacle_avoidance.rules")
    return behaviors
