"""Scenarios: YAML on dataclasses, with every mistake reported as file, key and valid values."""

import copy
import dataclasses
import types
import typing
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import yaml
from naraha.models import MODELS_DIR
from naraha.systems.config import check_config
from naraha.systems.errors import ScenarioError
from pydrake.common.yaml import yaml_dump, yaml_dump_typed, yaml_load_data, yaml_load_typed

SCENARIOS_DIR = MODELS_DIR / "scenarios"


def shipped_scenarios() -> list[str]:
    """Names of the scenarios that come with the package."""
    return sorted(path.stem for path in SCENARIOS_DIR.glob("*.yaml"))


def load_scenario[T](
    schema: type[T], name: str, settings: Iterable[str] = (), seed: int | None = None, *, base: Path | None = None
) -> T:
    """Reads a scenario, applies settings, and checks every key and every range.

    Args:
        schema: keyword-only dataclass to fill; what the file does not say keeps its default.
        name: a shipped scenario's name, or a YAML file; its key `extends` names another one whose values hold where it
            has none.
        settings: `path=value` items of the command line; the path is dotted, the value YAML.
        seed: replaces the scenario's `seed`.
        base: a YAML file whose values hold where the scenario has none, such as that of a robot.

    Raises:
        ScenarioError, ConfigError: one line that names file, key and the valid values.
    """
    path = _find(name)
    sources: list[tuple[object, dict[str, Any]]] = [(file, values) for file, values in _read_chain(path)]
    if base is not None:
        # A robot's file serves every mission: each takes what it knows.
        known = _fields(schema) or {}
        sources.insert(0, (base, {key: value for key, value in _read(base).items() if key in known}))
    data: dict[str, Any] = {}
    for _, source in sources:
        data = _merged(data, source)
    for setting in settings:
        sources.append(_apply_setting(data, setting))
    _fill_in(schema, data)
    for where, source in sources:
        _check_keys(schema, _with_tags(source, data), where, "")
    if seed is not None:
        data["seed"] = seed
    try:
        scenario: T = yaml_load_typed(schema=schema, data=yaml_dump(data))
    except Exception as error:  # yaml_load_typed raises many kinds; all of them mean a value of the wrong type
        raise ScenarioError(f"wrong type: {_one_line(error)}", where=path) from None
    check_config(scenario, where=path)
    return scenario


def dump_scenario(scenario: Any) -> str:
    """The scenario as YAML that `load_scenario` reads back to the same; Drake leaves fields out that are null."""
    data = yaml_load_data(yaml_dump_typed(scenario), private=True)
    _add_nulls(scenario, data)
    return yaml_dump(data)


def _add_nulls(config: Any, data: Any) -> None:
    if not dataclasses.is_dataclass(config) or not isinstance(data, dict):
        return
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if value is None:
            data[field.name] = None
        else:
            _add_nulls(value, data.get(field.name))


def _read_chain(path: Path) -> list[tuple[Path, dict[str, Any]]]:
    """A scenario file and before it those that it `extends`, each with its own values; the last one wins."""
    chain: list[tuple[Path, dict[str, Any]]] = []
    while True:
        if path in [seen for seen, _ in chain]:
            raise ScenarioError("extends itself", where=path, key="extends")
        values = _read(path)
        parent = values.pop("extends", None)
        chain.insert(0, (path, values))
        if parent is None:
            return chain
        path = _find(str(parent))


def _read(path: Path) -> dict[str, Any]:
    """The mapping in a YAML file."""
    try:
        data = yaml_load_data(path.read_text())
    except OSError as error:
        raise ScenarioError(error.strerror or "cannot be read", where=path) from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ScenarioError(f"not YAML: {_one_line(error)}", where=path) from None
    if not isinstance(data, dict):
        raise ScenarioError("not a scenario", where=path, value=data, valid="a mapping of keys to values")
    return data


def _merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """A copy of `base` with the values of `over`, by mapping; a mapping with another tag replaces the whole."""
    merged: dict[str, Any] = copy.deepcopy(dict(base))
    for key, value in over.items():
        below: Any = merged.get(key)
        mappings = isinstance(value, Mapping) and isinstance(below, Mapping)
        if mappings and value.get("_tag", below.get("_tag")) == below.get("_tag"):
            merged[key] = _merged(below, value)
        else:
            merged[key] = copy.deepcopy(value)
    return merged


def _find(name: str) -> Path:
    if name in shipped_scenarios():
        return SCENARIOS_DIR / f"{name}.yaml"
    path = Path(name)
    if path.is_file():
        return path
    raise ScenarioError("no such scenario or file", where=name, valid=[*shipped_scenarios(), "a YAML file"])


def _apply_setting(data: dict[str, Any], setting: str) -> tuple[str, dict[str, Any]]:
    """Changes `data`; returns what to call the setting in errors, and what it says, as a scenario of its own."""
    where = f"--set {setting}"
    path, equals, text = setting.partition("=")
    keys = path.split(".")
    if not equals or not all(keys):
        raise ScenarioError("not a setting", where=where, valid="path=value, such as lidar.range_noise=0.01")
    try:
        value = yaml_load_data(text, private=True)
    except yaml.YAMLError as error:
        raise ScenarioError(f"value is not YAML: {_one_line(error)}", where=where) from None
    branch: dict[str, Any] = {}
    leaf = branch
    for key in keys[:-1]:
        leaf[key] = leaf = {}
    leaf[keys[-1]] = copy.deepcopy(value)
    for key in keys[:-1]:
        if not isinstance(data.get(key), dict):
            data[key] = {}
        data = data[key]
    data[keys[-1]] = value
    return where, branch


def _fill_in(schema: Any, data: Any) -> None:
    """Lets every part of the schema that has a `fill_in` complete its entries by each other."""
    if dataclasses.is_dataclass(schema) and isinstance(data, dict):
        for field in dataclasses.fields(schema):
            _fill_in(field.type, data.get(field.name))
        if hasattr(schema, "fill_in"):
            schema.fill_in(data)


def _with_tags(source: Any, data: Any) -> Any:
    """A copy of `source` with the tags that `data` has in the same places."""
    if not isinstance(source, dict) or not isinstance(data, dict):
        return source
    tags = {"_tag": data["_tag"]} if "_tag" in data else {}
    return tags | {key: _with_tags(value, data.get(key)) for key, value in source.items()}


def _check_keys(schema: Any, data: Any, where: object, key: str) -> None:
    """Raises `ScenarioError` for the first key that the schema does not have."""
    schema = _choose(schema, data)
    origin, arguments = typing.get_origin(schema), typing.get_args(schema)
    if isinstance(data, Mapping) and origin in (dict, Mapping):
        for name, value in data.items():
            _check_keys(arguments[1], value, where, f"{key}.{name}" if key else str(name))
    elif isinstance(data, list) and origin is list:
        for i, value in enumerate(data):
            _check_keys(arguments[0], value, where, f"{key}[{i}]")
    elif isinstance(data, Mapping):
        known = _fields(schema)
        for name, value in data.items():
            path = f"{key}.{name}" if key else str(name)
            if name == "_tag":
                continue
            if known is None:
                raise ScenarioError("takes no keys", where=where, key=key, value=name)
            if name not in known:
                close = get_close_matches(str(name), known, n=1)
                hint = f"; did you mean '{close[0]}'?" if close else ""
                raise ScenarioError(f"unknown key{hint}", where=where, key=path, valid=sorted(known))
            _check_keys(known[name], value, where, path)


def _choose(schema: Any, data: Any) -> Any:
    """The member of a union that `data` is for: by its tag, else the first one."""
    if typing.get_origin(schema) not in (typing.Union, types.UnionType):
        return schema
    members = [m for m in typing.get_args(schema) if m is not types.NoneType]
    tag = data.get("_tag") if isinstance(data, Mapping) else None
    return next((m for m in members if tag == f"!{m.__name__}"), members[0])


def _fields(schema: Any) -> dict[str, Any] | None:
    if dataclasses.is_dataclass(schema):
        return {field.name: field.type for field in dataclasses.fields(schema)}
    fields = getattr(schema, "__fields__", None)  # Drake's own schema types
    return None if fields is None else {field.name: field.type for field in fields}


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
