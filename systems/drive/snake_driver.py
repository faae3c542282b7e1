"""The snake's driver beside the plant, applied by Drake's `ApplyDriverConfigs`."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydrake.multibody.parsing import ModelInstanceInfo
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from .models import find_model
from .snake_drives import SnakeDrives, SnakeDrivesConfig


@dataclass(kw_only=True)
class SnakeDriver(SnakeDrivesConfig):
    """Driver of a snake."""


def ApplyDriverConfig(
    driver_config: SnakeDriver,
    model_instance_name: str,
    sim_plant: MultibodyPlant,
    models_from_directives: Mapping[str, ModelInstanceInfo],
    lcm_buses: Any,
    builder: DiagramBuilder,
) -> None:
    """Adds the `SnakeDrives` "{model_instance_name}.driver" and connects it to the plant.

    Its free ports are the commands and measurements of the snake. `models_from_directives` may be empty, `lcm_buses`
    is not used.

    Raises:
        ConfigError: the plant has no such snake, or a value is out of range.
    """
    model_instance = find_model(sim_plant, model_instance_name, models_from_directives)
    driver = builder.AddNamedSystem(
        f"{model_instance_name}.driver", SnakeDrives(driver_config, sim_plant, model_instance)
    )
    builder.Connect(sim_plant.get_state_output_port(model_instance), driver.GetInputPort("state"))
    builder.Connect(sim_plant.get_net_actuation_output_port(model_instance), driver.GetInputPort("net_actuation"))
    builder.Connect(driver.GetOutputPort("desired_state"), sim_plant.get_desired_state_input_port(model_instance))
