"""Configurations as YAML files of their own: what a robot can, how its motions end, how it behaves."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import yaml
from pydrake.common.yaml import yaml_load_data, yaml_load_typed

from .config import check_config
from .errors import ConfigError
from .files import replacing


def read_config[T](path: Path, schema: type[T], what: str) -> T:
    """Reads a dataclass and checks the range of its values.

    Args:
        what: "not an ability", for the error.

    Raises:
        ConfigError: no such file, not YAML, an unknown key, a value out of range.
    """
    try:
        text = path.read_text()
        if not isinstance(yaml_load_data(text), dict):
            raise ValueError("not a mapping")
        config: T = yaml_load_typed(schema=schema, data=text)
    except OSError as error:
        raise ConfigError(error.strerror or "cannot be read", where=path) from None
    except (yaml.YAMLError, ValueError, RuntimeError, TypeError, KeyError) as error:
        raise ConfigError(f"{what}: {' '.join(str(error).split())}", where=path) from None
    check_config(config, where=path)
    return config


def write_config(path: Path, config: Any) -> None:
    """Writes a dataclass that `read_config` reads back to the same."""
    with replacing(path) as temporary:
        temporary.write_text(yaml.safe_dump(asdict(config), sort_keys=False, default_flow_style=None, width=120))
