"""The behaviours of a robot as one YAML file."""

from dataclasses import dataclass, field
from pathlib import Path

import yaml
from pydrake.common.yaml import yaml_load_data, yaml_load_typed

from ..config import check_config
from ..errors import ConfigError
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
    try:
        text = path.read_text()
        if not isinstance(yaml_load_data(text), dict):
            raise ValueError("not a mapping")
        behaviors: Behaviors = yaml_load_typed(schema=Behaviors, data=text)
    except OSError as error:
        raise ConfigError(error.strerror or "cannot be read", where=path) from None
    except (yaml.YAMLError, ValueError, RuntimeError, TypeError, KeyError) as error:
        raise ConfigError(f"not behaviours: {' '.join(str(error).split())}", where=path) from None
    check_config(behaviors, where=path)
    RuleBase(behaviors.goal_seeking, GOAL_INPUTS, 2, where=path, key="goal_seeking")
    RuleBase(behaviors.obstacle_avoidance.rules, AVOIDANCE_INPUTS, 2, where=path, key="obstacle_avoidance.rules")
    return behaviors
