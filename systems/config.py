"""Configuration dataclasses: how a field states its unit and range, and the one function that checks them.

A configuration is a keyword-only dataclass per feature, loadable with `pydrake.common.yaml.yaml_load_typed`.
Bounds are stated where the field is declared, so that a scenario file, a `--set` and a constructor call are all
checked by the same rule and fail with the same words.
"""

import dataclasses
import math
from typing import Any

import numpy as np

from .errors import ConfigError


def quantity(
    default: Any,
    *,
    unit: str = "",
    above: float = -math.inf,
    low: float = -math.inf,
    high: float = math.inf,
    choices: tuple[str, ...] = (),
    min_length: int = 0,
) -> Any:
    """Declares a dataclass field with a unit and a valid range.

    Args:
        default: the default value; a list is copied for every instance.
        unit: unit of the value, shown in errors.
        above: exclusive lower bound. low, high: inclusive bounds. Bounds hold for every entry of a list.
        choices: valid values of a string.
        min_length: of a list.
    """
    metadata = {"unit": unit, "above": above, "low": low, "high": high, "choices": choices, "min_length": min_length}
    if isinstance(default, (list, dict)):
        return dataclasses.field(default_factory=lambda: default.copy(), metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def check_config(config: Any, *, where: object = "", key: str = "") -> None:
    """Raises `ConfigError` for the first field of `config`, at any depth, whose value is not finite or out of range.

    Args:
        config: a dataclass instance; nested dataclasses, lists and mappings of dataclasses are walked.
        where: file that the configuration came from, for the error.
        key: dotted path of `config` itself, for the error.
    """
    if dataclasses.is_dataclass(config) and not isinstance(config, type):
        for field in dataclasses.fields(config):
            path = f"{key}.{field.name}" if key else field.name
            value = getattr(config, field.name)
            if "unit" in field.metadata:
                _check_range(value, field.metadata, where, path)
            check_config(value, where=where, key=path)
    elif isinstance(config, dict):
        for name, value in config.items():
            check_config(value, where=where, key=f"{key}.{name}" if key else str(name))
    elif isinstance(config, (list, tuple)):
        for i, value in enumerate(config):
            check_config(value, where=where, key=f"{key}[{i}]")


def _check_range(value: Any, bounds: Any, where: object, key: str) -> None:
    if value is None:
        return
    if bounds["choices"]:
        if value not in bounds["choices"]:
            raise ConfigError("unknown value", where=where, key=key, value=value, valid=bounds["choices"])
        return
    try:
        numbers = np.atleast_1d(np.asarray(value, dtype=float))
    except (TypeError, ValueError):
        raise ConfigError("not a number", where=where, key=key, value=value, valid=_range_in_words(bounds)) from None
    if len(numbers) < bounds["min_length"]:
        valid = f"at least {bounds['min_length']}, each {_range_in_words(bounds)}"
        wrong = "too few" if len(numbers) else "must not be empty"
        raise ConfigError(wrong, where=where, key=key, value=value, valid=valid)
    inside = np.isfinite(numbers) & (numbers > bounds["above"])
    inside &= (numbers >= bounds["low"]) & (numbers <= bounds["high"])
    if not inside.all():
        raise ConfigError("out of range", where=where, key=key, value=value, valid=_range_in_words(bounds))


def _range_in_words(bounds: Any) -> str:
    words = []
    if math.isfinite(bounds["above"]):
        words.append(f"> {bounds['above']:g}")
    if math.isfinite(bounds["low"]):
        words.append(f">= {bounds['low']:g}")
    if math.isfinite(bounds["high"]):
        words.append(f"<= {bounds['high']:g}")
    return f"{' and '.join(words) or 'any finite number'} {bounds['unit']}".strip()
