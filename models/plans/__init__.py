"""Floor plans of halls, in YAML."""

from pathlib import Path

from naraha.systems.errors import PlanError
from naraha.systems.placement.floor_plan import FloorPlan
from naraha.systems.placement.plan_files import read_floor_plan

PLANS_DIR = Path(__file__).parent


def shipped_plans() -> list[str]:
    """Names of the plans that come with the package."""
    return sorted(path.stem for path in PLANS_DIR.glob("*.yaml"))


def load_floor_plan(name: str | Path) -> FloorPlan:
    """Reads and checks the shipped plan `name`, or the YAML file of that name.

    Raises:
        PlanError, ConfigError: there is no such plan, or it cannot be used; names file, key and valid values.
    """
    if str(name) in shipped_plans():
        return read_floor_plan(PLANS_DIR / f"{name}.yaml")
    if not Path(name).is_file():
        raise PlanError("no such floor plan", where=name, valid=[*shipped_plans(), "a YAML file"])
    return read_floor_plan(Path(name))


__all__ = ["PLANS_DIR", "load_floor_plan", "shipped_plans"]
