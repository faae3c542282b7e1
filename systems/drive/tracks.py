"""What the drivers of all tracked robots share: their driven surfaces, and track drives with encoders."""

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import DiagramBuilder, System

from ..errors import ConfigError
from ..sensing import TrackEncoders, TrackEncodersConfig
from .track_driver import TrackDriver, TrackDriverConfig


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


def add_tracks(
    builder: DiagramBuilder,
    config: TrackDriverConfig,
    encoders_config: TrackEncodersConfig,
    plant: MultibodyPlant,
    model_instance: ModelInstanceIndex,
    *,
    command: str,
) -> None:
    """Adds `track_driver` and `track_encoders` to a driver's diagram and exports their ports.

    Inputs: `twist_command` or `track_speed_command`, as `command` says ("twist" or "track_speeds"), and
    `surface_displacements`. Outputs: `track_speeds`, `track_displacements`, `commanded_track_speeds`, `surface_speeds`.
    """
    left, right = find_track_surfaces(plant, model_instance)
    tracks = builder.AddNamedSystem("track_driver", TrackDriver(config, left, right))
    encoders = builder.AddNamedSystem("track_encoders", TrackEncoders(encoders_config, left[0], right[0]))
    export_inputs(builder, tracks, command_port(command))
    export_inputs(builder, encoders, "surface_displacements")
    export_outputs(builder, encoders, "track_speeds", "track_displacements")
    export_outputs(builder, tracks, "commanded_track_speeds", "surface_speeds")


def connect_tracks(builder: DiagramBuilder, driver: System, plant: MultibodyPlant) -> None:
    """Connects `surface_speeds` and `surface_displacements` of a driver to the plant.

    Raises:
        ConfigError: the plant's `surface_speeds` port, which it has once for all models, is already connected.
    """
    surface_speeds = plant.get_surface_speeds_input_port()
    if builder.IsConnectedOrExported(surface_speeds):
        problem = "the plant's surface_speeds port is already connected: one tracked robot a plant"
        raise ConfigError(problem, key=driver.get_name().removesuffix(".driver"))
    builder.Connect(driver.GetOutputPort("surface_speeds"), surface_speeds)
    builder.Connect(plant.get_surface_displacements_output_port(), driver.GetInputPort("surface_displacements"))


def command_port(command: str) -> str:
    """Name of the input port for a driver's `command`."""
    return "twist_command" if command == "twist" else "track_speed_command"


def export_inputs(builder: DiagramBuilder, system: System, *names: str) -> None:
    """Exports input ports of `system` under their own names."""
    for name in names:
        builder.ExportInput(system.GetInputPort(name), name)


def export_outputs(builder: DiagramBuilder, system: System, *names: str) -> None:
    """Exports output ports of `system` under their own names."""
    for name in names:
        builder.ExportOutput(system.GetOutputPort(name), name)
