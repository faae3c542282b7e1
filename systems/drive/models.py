"""Models of a plant by name, for the drivers of all robots."""

from collections.abc import Mapping

from pydrake.multibody.parsing import ModelInstanceInfo
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex

from ..errors import ConfigError


def find_model(
    plant: MultibodyPlant, name: str, models_from_directives: Mapping[str, ModelInstanceInfo]
) -> ModelInstanceIndex:
    """Index of the model `name`. Raises `ConfigError` when the plant has none of that name."""
    if name in models_from_directives:
        return models_from_directives[name].model_instance
    if plant.HasModelInstanceNamed(name):
        return plant.GetModelInstanceByName(name)
    raise ConfigError("the plant has no such model", key="driver", value=name)
