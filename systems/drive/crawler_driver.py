"""The crawler's drive as one diagram beside the plant, applied by Drake's `ApplyDriverConfigs`."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pydrake.multibody.parsing import ModelInstanceInfo
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import Diagram, DiagramBuilder

from ..config import check_config, quantity
from ..errors import ConfigError
from ..sensing import TrackEncoders, TrackEncodersConfig
from .flipper_driver import FlipperDriver, FlipperDriverConfig
from .flipper_rule import FlipperRule, FlipperRuleConfig
from .track_driver import TrackDriver, TrackDriverConfig


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
    if model_instance_name in models_from_directives:
        model_instance = models_from_directives[model_instance_name].model_instance
    elif sim_plant.HasModelInstanceNamed(model_instance_name):
        model_instance = sim_plant.GetModelInstanceByName(model_instance_name)
    else:
        raise ConfigError("the plant has no such model", key="driver", value=model_instance_name)
    surface_speeds = sim_plant.get_surface_speeds_input_port()
    if builder.IsConnectedOrExported(surface_speeds):
        problem = "the plant's surface_speeds port is already connected: one crawler a plant"
        raise ConfigError(problem, key=model_instance_name)
    driver = builder.AddNamedSystem(
        f"{model_instance_name}.driver", make_crawler_driver(driver_config, sim_plant, model_instance)
    )
    builder.Connect(driver.GetOutputPort("surface_speeds"), surface_speeds)
    builder.Connect(driver.GetOutputPort("desired_state"), sim_plant.get_desired_state_input_port(model_instance))
    builder.Connect(sim_plant.get_state_output_port(model_instance), driver.GetInputPort("state"))
    builder.Connect(sim_plant.get_surface_displacements_output_port(), driver.GetInputPort("surface_displacements"))


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
    left, right = find_track_surfaces(plant, model_instance)
    builder = DiagramBuilder()
    tracks = builder.AddNamedSystem("track_driver", TrackDriver(config, left, right))
    flippers = builder.AddNamedSystem("flipper_driver", FlipperDriver(config, plant, model_instance))
    rule = builder.AddNamedSystem("flipper_rule", FlipperRule(config))
    encoders = builder.AddNamedSystem("track_encoders", TrackEncoders(config.encoders, left[0], right[0]))
    builder.Connect(rule.GetOutputPort("flipper_command"), flippers.GetInputPort("flipper_command"))
    command_port = "twist_command" if config.command == "twist" else "track_speed_command"
    for system, name in (
        (tracks, command_port),
        (rule, "rpy"),
        (rule, "flipper_preset"),
        (flippers, "state"),
        (encoders, "surface_displacements"),
    ):
        builder.ExportInput(system.GetInputPort(name), name)
    for system, name in (
        (encoders, "track_speeds"),
        (encoders, "track_displacements"),
        (tracks, "commanded_track_speeds"),
        (flippers, "flipper_angles"),
        (rule, "active_preset"),
        (tracks, "surface_speeds"),
        (flippers, "desired_state"),
    ):
        builder.ExportOutput(system.GetOutputPort(name), name)
    return builder.Build()


def find_track_surfaces(plant: MultibodyPlant, model_instance: ModelInstanceIndex) -> tuple[list[str], list[str]]:
    """Scoped names of the driven surfaces on the left and on the right, the main track first on either side.

    A surface is a link with a surface-velocity axis; its name holds "left" or "right", and the tracks are
    `left_track` and `right_track`.

    Raises:
        ConfigError: there is no such pair of tracks, or a surface that is on neither side.
    """
    links = [plant.get_body(i) for i in plant.GetBodyIndices(model_instance)]
    surfaces = [link for link in links if plant.GetSurfaceVelocityAxis(link) is not None]
    driven = {link.name(): link.scoped_name().get_full() for link in surfaces}
    sides: list[list[str]] = []
    for side in ("left", "right"):
        names = sorted((name for name in driven if side in name), key=lambda name: (not name.endswith("_track"), name))
        if f"{side}_track" not in names:
            raise ConfigError(
                "the model has no native track of this name",
                key=plant.GetModelInstanceName(model_instance),
                value=list(driven),
                valid=f"{side}_track",
            )
        sides.append([driven[name] for name in names])
    if len(sides[0]) + len(sides[1]) != len(driven):
        model = plant.GetModelInstanceName(model_instance)
        raise ConfigError("a driven surface is neither left nor right", key=model, value=list(driven))
    return sides[0], sides[1]
