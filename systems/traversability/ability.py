"""What a robot can drive over: membership functions, rules and limits, one YAML file a robot (rows S3-b, S3-e)."""

from dataclasses import dataclass, field
from pathlib import Path

from ..config import check_config, quantity
from ..config_files import read_config, write_config
from ..errors import ConfigError
from .mamdani import FuzzyConfig, check_fuzzy


@dataclass(kw_only=True)
class Ability:
    """What one robot can drive over.

    A rectangle of ground is impassable when one of the thresholds is exceeded, or when its risk reaches `risk_limit`.
    """

    robot: str = ""
    # How these numbers came about.
    source: str = ""
    fuzzy: FuzzyConfig = field(default_factory=FuzzyConfig)
    # [m] z_th (S3-a): mean height over the ground below the robot above which a rectangle is impassable.
    height_threshold: float = quantity(0.3, unit="m", above=0)
    # [m] Highest step, up or down.
    step_threshold: float = quantity(0.1, unit="m", above=0)
    # [m] Highest step that it climbs, where a LiDAR cannot tell one as low from noise; null where `step_threshold` is
    # that. Steps between the two count where they are the end of one above the threshold, as at the side of a ramp.
    step_limit: float | None = quantity(None, unit="m", low=0)
    # [-] Share of a rectangle that must have been seen: what was not seen is not safe.
    min_coverage: float = quantity(0.5, unit="-", low=0, high=1)
    # [-] r_limit: risk from which on a rectangle is impassable.
    risk_limit: float = quantity(60.0, unit="-", above=0)
    # [m] Length and width of the robot.
    footprint: list[float] = quantity([0.6, 0.5], unit="m", above=0, min_length=2)
    # [m], [rad/s] Fastest that it is driven.
    max_speed: float = quantity(0.5, unit="m/s", above=0)
    max_yaw_rate: float = quantity(0.8, unit="rad/s", above=0)
    # [m/rad] How far it slides along its axis while it turns on the spot, times the sine of its pitch: tracks that skid
    # sideways hold little lengthwise.
    turn_slide: float = quantity(0.0, unit="m/rad", low=0)


def read_ability(path: Path) -> Ability:
    """Reads and checks an ability.

    Raises:
        ConfigError: no such file, not YAML, an unknown key, a value out of range, memberships that are no trapezoids,
            or a table of rules with a hole.
    """
    ability = read_config(path, Ability, "not an ability")
    check_ability(ability, where=path)
    return ability


def write_ability(path: Path, ability: Ability) -> None:
    """Writes an ability that `read_ability` reads back to the same."""
    write_config(path, ability)


def check_ability(ability: Ability, *, where: object = "ability") -> None:
    """Raises `ConfigError` for the first value that cannot be used."""
    check_config(ability, where=where)
    if len(ability.footprint) != 2:
        raise ConfigError("wrong length", where=where, key="footprint", value=ability.footprint, valid="length, width")
    check_fuzzy(ability.fuzzy, where=where, key="fuzzy")
