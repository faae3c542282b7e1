"""What lies beside the model of a robot: what it brings along to a station, what it can drive over, its motions."""

from pathlib import Path

from naraha.models import MODELS_DIR
from naraha.systems.errors import ScenarioError
from naraha.systems.routes import Primitives, read_primitives
from naraha.systems.traversability import Ability, read_ability

# Files beside a model that are no ability.
_OTHERS = ("station", "primitives")


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
    folder = _folder(model)
    path = folder / f"{name}.yaml"
    if path.is_file() and name not in _OTHERS:
        return read_ability(path)
    if not Path(name).is_file():
        valid = [*sorted(p.stem for p in folder.glob("*.yaml") if p.stem not in _OTHERS), "a YAML file"]
        raise ScenarioError(f"no such ability of '{model}'", key="ability", value=name, valid=valid)
    return read_ability(Path(name))


def has_primitives(model: str) -> bool:
    """Whether the motions of route learning were measured for a shipped model of a robot."""
    return (_folder(model) / "primitives.yaml").is_file()


def robot_primitives(model: str) -> Primitives:
    """What the motions of route learning come to for a shipped model of a robot, as measured.

    Raises:
        ScenarioError: they were not measured. ConfigError: the file cannot be used.
    """
    path = _folder(model) / "primitives.yaml"
    if not path.is_file():
        valid = sorted(path.parent.name for path in MODELS_DIR.glob("*/primitives.yaml"))
        raise ScenarioError("no motions were measured", key="robot", value=model, valid=valid)
    return read_primitives(path)


def _folder(model: str) -> Path:
    return next((path.parent for path in MODELS_DIR.glob(f"*/{model}.urdf")), MODELS_DIR / model)
