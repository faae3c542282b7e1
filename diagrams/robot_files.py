"""What lies beside the model of a robot: what it brings along to a station, and what it can drive over."""

from pathlib import Path

from naraha.models import MODELS_DIR
from naraha.systems.errors import ScenarioError
from naraha.systems.traversability import Ability, read_ability


def robot_file(robot: str) -> Path:
    """The robot's part of a scenario, for `load_scenario(base=…)`. Raises `ScenarioError`."""
    path = MODELS_DIR / robot / "station.yaml"
    if not path.is_file():
        valid = sorted(path.parent.name for path in MODELS_DIR.glob("*/station.yaml"))
        raise ScenarioError("unknown robot", where="--robot", value=robot, valid=valid)
    return path


def robot_ability(model: str, name: str = "ability") -> Ability:
    """The ability `name` of a shipped model of a robot, or the one in the YAML file of that name.

    Raises:
        ScenarioError: there is no such file. ConfigError: it cannot be used.
    """
    folder = next((path.parent for path in MODELS_DIR.glob(f"*/{model}.urdf")), MODELS_DIR / model)
    path = folder / f"{name}.yaml"
    if path.is_file() and name != "station":
        return read_ability(path)
    if not Path(name).is_file():
        valid = [*sorted(p.stem for p in folder.glob("*.yaml") if p.stem != "station"), "a YAML file"]
        raise ScenarioError(f"no such ability of '{model}'", key="ability", value=name, valid=valid)
    return read_ability(Path(name))
