"""The drive of a robot with two driven wheels, applied by Drake's `ApplyDriverConfigs`."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pydrake.multibody.parsing import ModelInstanceInfo
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import Diagram, DiagramBuilder

from ..config import check_config, quantity
from ..sensing import TrackEncoders, TrackEncodersConfig
from .models import find_model
from .setpoints import add_setpoints
from .tilt_unit import tilt_joints
from .tracks import command_port, export_inputs, export_outputs
from .wheel_driver import WHEELS, WheelDriver, WheelDriverConfig


@dataclass(kw_only=True)
class DifferentialDriver(WheelDriverConfig):
    """Driver of a robot with two driven wheels and a caster."""

    # What drives the wheels, and which of the ports `twist_command` and `track_speed_command` there is.
    command: str = quantity("twist", choices=("twist", "track_speeds"))
    # Encoders of the two wheels, in metres of the rim: some 76 000 counts a turn of 0.61 m. Assumed.
    encoders: TrackEncodersConfig = field(default_factory=lambda: TrackEncodersConfig(resolution=8e-6))


def ApplyDriverConfig(
    driver_config: DifferentialDriver,
    model_instance_name: str,
    sim_plant: MultibodyPlant,
    models_from_directives: Mapping[str, ModelInstanceInfo],
    lcm_buses: Any,
    builder: DiagramBuilder,
) -> None:
    """Adds the diagram "{model_instance_name}.driver" (see `make_differential_driver`) and connects it to the plant.

    Its free ports are the commands and measurements of the robot. `models_from_directives` may be empty, `lcm_buses`
    is not used.

    Raises:
        ConfigError: the plant has no such robot, or a value is out of range.
    """
    model_instance = find_model(sim_plant, model_instance_name, models_from_directives)
    driver = builder.AddNamedSystem(
        f"{model_instance_name}.driver", make_differential_driver(driver_config, sim_plant, model_instance)
    )
    builder.Connect(driver.GetOutputPort("desired_state"), sim_plant.get_desired_state_input_port(model_instance))
    builder.Connect(sim_plant.get_state_output_port(model_instance), driver.GetInputPort("state"))


def make_differential_driver(
    config: DifferentialDriver, plant: MultibodyPlant, model_instance: ModelInstanceIndex
) -> Diagram:
    """Wheel drives and encoders of one robot as a diagram.

    Input ports: `twist_command` or `track_speed_command` (as `config.command` says), `state` from the plant, and, on a
    robot with a tilt unit, `tilt_setpoint` (see `TiltSweep`). Output ports: `track_speeds`, `track_displacements`
    (encoders, of the rims), `commanded_track_speeds`, and for the plant `desired_state`.

    Raises:
        ConfigError: a value is out of range, or the model is no such robot.
    """
    check_config(config)
    builder = DiagramBuilder()
    wheels = builder.AddNamedSystem("wheel_driver", WheelDriver(config, plant, model_instance))
    left, right = (plant.GetBodyByName(name, model_instance).scoped_name().get_full() for name in WHEELS)
    encoders = builder.AddNamedSystem("wheel_encoders", TrackEncoders(config.encoders, left, right))
    builder.Connect(wheels.GetOutputPort("surface_displacements"), encoders.GetInputPort("surface_displacements"))
    export_inputs(builder, wheels, command_port(config.command), "state")
    export_outputs(builder, encoders, "track_speeds", "track_displacements")
    export_outputs(builder, wheels, "commanded_track_speeds")
    tilt = tilt_joints(plant, model_instance)
    groups = {"wheels": [f"{wheel}_joint" for wheel in WHEELS]} | ({"tilt": tilt} if tilt else {})
    setpoints = add_setpoints(builder, plant, model_instance, groups)
    builder.Connect(wheels.GetOutputPort("wheel_setpoint"), setpoints.get_input_port(0))
    if tilt:
        builder.ExportInput(setpoints.get_input_port(1), "tilt_setpoint")
    return builder.Build()
