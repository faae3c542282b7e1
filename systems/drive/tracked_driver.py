"""The drive of a robot with two tracks and no flippers, applied by Drake's `ApplyDriverConfigs`."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pydrake.multibody.parsing import ModelInstanceInfo
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import Diagram, DiagramBuilder

from ..config import check_config, quantity
from ..sensing import TrackEncodersConfig
from .models import find_model
from .setpoints import add_setpoints
from .tilt_unit import tilt_joints
from .track_driver import TrackDriverConfig
from .tracks import add_tracks, connect_tracks


@dataclass(kw_only=True)
class TrackedDriver(TrackDriverConfig):
    """Driver of a robot with two tracks. Speed and acceleration of the amphibious robot (S3-e) are assumed."""

    max_speed: float = quantity(0.8, unit="m/s", above=0.0)
    max_acceleration: float = quantity(1.0, unit="m/s^2", above=0.0)
    # `skid_steer.effective_gauge` gives 0.563 m for tracks 0.51 m apart of which 0.39 m lie on the ground; belts of
    # 0.14 m scrub at both their edges, and `quasi_static_twist` at these gives 0.59 m.
    gauge: float = quantity(0.59, unit="m", above=0.0)
    # What drives the tracks, and which of the ports `twist_command` and `track_speed_command` there is.
    command: str = quantity("twist", choices=("twist", "track_speeds"))
    # Encoders of the two tracks.
    encoders: TrackEncodersConfig = field(default_factory=TrackEncodersConfig)


def ApplyDriverConfig(
    driver_config: TrackedDriver,
    model_instance_name: str,
    sim_plant: MultibodyPlant,
    models_from_directives: Mapping[str, ModelInstanceInfo],
    lcm_buses: Any,
    builder: DiagramBuilder,
) -> None:
    """Adds the diagram "{model_instance_name}.driver" (see `make_tracked_driver`) and connects it to the plant.

    Its free ports are the commands and measurements of the robot. `models_from_directives` may be empty, `lcm_buses`
    is not used.

    Raises:
        ConfigError: the plant has no such robot, a value is out of range, or the plant's `surface_speeds` port, which
            it has once for all models, is already connected.
    """
    model_instance = find_model(sim_plant, model_instance_name, models_from_directives)
    driver = builder.AddNamedSystem(
        f"{model_instance_name}.driver", make_tracked_driver(driver_config, sim_plant, model_instance)
    )
    connect_tracks(builder, driver, sim_plant)
    if driver.HasOutputPort("desired_state"):
        builder.Connect(driver.GetOutputPort("desired_state"), sim_plant.get_desired_state_input_port(model_instance))


def make_tracked_driver(config: TrackedDriver, plant: MultibodyPlant, model_instance: ModelInstanceIndex) -> Diagram:
    """Track drives and encoders of one robot as a diagram.

    Input ports: `twist_command` or `track_speed_command` (as `config.command` says), `surface_displacements` from the
    plant, and, on a robot with a tilt unit, `tilt_setpoint` (see `TiltSweep`). Output ports: `track_speeds`,
    `track_displacements` (encoders), `commanded_track_speeds`, for the plant `surface_speeds` and, with a tilt unit,
    `desired_state`.

    Raises:
        ConfigError: a value is out of range, or the model is no such robot.
    """
    check_config(config)
    builder = DiagramBuilder()
    add_tracks(builder, config, config.encoders, plant, model_instance, command=config.command)
    tilt = tilt_joints(plant, model_instance)
    if tilt:
        setpoints = add_setpoints(builder, plant, model_instance, {"tilt": tilt})
        builder.ExportInput(setpoints.get_input_port(0), "tilt_setpoint")
    return builder.Build()
