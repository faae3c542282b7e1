"""The crawler's drive as one diagram beside the plant, applied by Drake's `ApplyDriverConfigs`."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pydrake.multibody.parsing import ModelInstanceInfo
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import Diagram, DiagramBuilder

from ..config import check_config, quantity
from ..sensing import TrackEncodersConfig
from .flipper_driver import FlipperDriver, FlipperDriverConfig
from .flipper_rule import FlipperRule, FlipperRuleConfig
from .models import find_model
from .track_driver import TrackDriverConfig
from .tracks import add_tracks, connect_tracks, export_inputs, export_outputs


@dataclass(kw_only=True)
class CrawlerDriver(TrackDriverConfig, FlipperDriverConfig, FlipperRuleConfig):
    """Driver of a crawler: the options of its track drives, flipper drives and flipper rule side by side."""

    # What drives the tracks, and which of the ports `twist_command` and `track_speed_command` there is.
    command: str = quantity("twist", choices=("twist", "track_speeds"))
    # Encoders of the two tracks.
    encoders: TrackEncodersConfig = field(default_factory=TrackEncodersConfig)


def ApplyDriverConfig(
    driver_config: CrawlerDriver,
    model_instance_name: str,
    sim_plant: MultibodyPlant,
    models_from_directives: Mapping[str, ModelInstanceInfo],
    lcm_buses: Any,
    builder: DiagramBuilder,
) -> None:
    """Adds the diagram "{model_instance_name}.driver" (see `make_crawler_driver`) and connects it to the plant.

    Its free ports are the commands and measurements of the crawler. `models_from_directives` may be empty, `lcm_buses`
    is not used.

    Raises:
        ConfigError: the plant has no such crawler, or its `surface_speeds` port, which it has once for all models, is
            already connected.
    """
    model_instance = find_model(sim_plant, model_instance_name, models_from_directives)
    driver = builder.AddNamedSystem(
        f"{model_instance_name}.driver", make_crawler_driver(driver_config, sim_plant, model_instance)
    )
    connect_tracks(builder, driver, sim_plant)
    builder.Connect(driver.GetOutputPort("desired_state"), sim_plant.get_desired_state_input_port(model_instance))
    builder.Connect(sim_plant.get_state_output_port(model_instance), driver.GetInputPort("state"))


def make_crawler_driver(config: CrawlerDriver, plant: MultibodyPlant, model_instance: ModelInstanceIndex) -> Diagram:
    """Tracks, flippers, flipper rule and encoders of one crawler as a diagram.

    Input ports: `twist_command` or `track_speed_command` (as `config.command` says), `rpy`, `flipper_preset`, and from
    the plant `state` and `surface_displacements`. Output ports: `track_speeds`, `track_displacements` (encoders),
    `commanded_track_speeds`, `flipper_angles`, `active_preset`, and for the plant `surface_speeds` and `desired_state`.
    What they carry is said at `TrackDriver`, `FlipperDriver`, `FlipperRule` and `TrackEncoders`.

    Raises:
        ConfigError: a value is out of range, or the model is not a crawler.
    """
    check_config(config)
    builder = DiagramBuilder()
    add_tracks(builder, config, config.encoders, plant, model_instance, command=config.command)
    flippers = builder.AddNamedSystem("flipper_driver", FlipperDriver(config, plant, model_instance))
    rule = builder.AddNamedSystem("flipper_rule", FlipperRule(config))
    builder.Connect(rule.GetOutputPort("flipper_command"), flippers.GetInputPort("flipper_command"))
    export_inputs(builder, rule, "rpy", "flipper_preset")
    export_inputs(builder, flippers, "state")
    export_outputs(builder, flippers, "flipper_angles", "desired_state")
    export_outputs(builder, rule, "active_preset")
    return builder.Build()
