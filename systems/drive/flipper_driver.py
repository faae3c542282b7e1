"""Position drives of the four flippers."""

from dataclasses import dataclass

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, EventStatus, LeafSystem

from ..config import check_config, quantity
from ..errors import ConfigError
from ..ports import eval_typed

FLIPPERS = ("front_left", "front_right", "rear_left", "rear_right")
"""Order of every vector of four flipper angles. An angle is 0 with the flipper flat and positive with its tip up."""


@dataclass(kw_only=True)
class FlipperDriverConfig:
    """Limits of the flipper drives."""

    # [s] between two samples of the command.
    period: float = quantity(0.02, unit="s", above=0.0)
    # [rad/s] largest speed of a flipper (Absolem: 0.8).
    flipper_max_speed: float = quantity(0.8, unit="rad/s", above=0.0)
    # [rad] range of the flippers, the joints' own in the crawler's URDF.
    flipper_lower: float = quantity(-1.6, unit="rad")
    flipper_upper: float = quantity(1.6, unit="rad")


def approach_angles(
    previous: np.ndarray, command: np.ndarray, lower: float, upper: float, max_change: float
) -> np.ndarray:
    """Moves each of `previous` towards `command`, clipped to [lower, upper], by at most `max_change`, all in [rad].

    Entries of `command` that are not finite hold their angle.
    """
    target = np.where(np.isfinite(command), np.clip(command, lower, upper), previous)
    return previous + np.clip(target - previous, -max_change, max_change)


class FlipperDriver(LeafSystem):
    """
    .. pydrake_system::

        name: FlipperDriver
        input_ports:
        - flipper_command
        - state
        output_ports:
        - desired_state
        - flipper_angles

    Four position drives with limited range and speed. `flipper_command` holds the wanted angles [rad] in the order of
    `FLIPPERS`; where it is not connected or not finite a flipper holds its place. `state` is the plant's state of the
    model instance; at the start the drives hold the angles that the flippers have there. `desired_state` is what the
    plant's port of that name takes, angles [rad] and then speeds [rad/s] in the order of the model's actuators;
    `flipper_angles` (4) [rad] are the measured angles, in the order of `FLIPPERS`.

    Raises `ConfigError` when a value is out of range or the model is not a crawler with four actuated flippers.
    """

    def __init__(self, config: FlipperDriverConfig, plant: MultibodyPlant, model_instance: ModelInstanceIndex):
        super().__init__()
        check_config(config)
        if config.flipper_lower > config.flipper_upper:
            raise ConfigError(
                "is above flipper_upper",
                key="flipper_lower",
                value=config.flipper_lower,
                valid=f"<= {config.flipper_upper:g} rad",
            )
        self._config = config
        self._angle_indices, self._actuator_order = _find_flippers(plant, model_instance)
        self._command = self.DeclareVectorInputPort("flipper_command", 4)
        self._plant_state = self.DeclareVectorInputPort("state", plant.num_multibody_states(model_instance))
        self.DeclareDiscreteState(8)  # angles, then speeds, in the order of FLIPPERS
        self.DeclareInitializationDiscreteUpdateEvent(self._Initialize)
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, 0.0, self._Update)
        self.DeclareVectorOutputPort(
            "desired_state",
            8,
            self._CalcDesiredState,
            prerequisites_of_calc={self.xd_ticket()},
        )
        self.DeclareVectorOutputPort(
            "flipper_angles", 4, self._CalcFlipperAngles, prerequisites_of_calc={self._plant_state.ticket()}
        )

    def _Initialize(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        discrete_state.set_value(np.concatenate([self._measured_angles(context), np.zeros(4)]))
        return EventStatus.Succeeded()

    def _Update(self, context: Context, discrete_state: DiscreteValues) -> None:
        config = self._config
        previous = context.get_discrete_state_vector().value()[:4]
        connected = self._command.HasValue(context)
        command = eval_typed(self, context, "flipper_command", np.ndarray) if connected else previous
        max_change = config.flipper_max_speed * config.period
        angles = approach_angles(previous, command, config.flipper_lower, config.flipper_upper, max_change)
        discrete_state.set_value(np.concatenate([angles, (angles - previous) / config.period]))

    def _CalcDesiredState(self, context: Context, output: BasicVector) -> None:
        setpoint = context.get_discrete_state_vector().value().reshape(2, 4)
        output.SetFromVector(setpoint[:, self._actuator_order].ravel())

    def _CalcFlipperAngles(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._measured_angles(context))

    def _measured_angles(self, context: Context) -> np.ndarray:
        return eval_typed(self, context, "state", np.ndarray)[self._angle_indices]


def _find_flippers(plant: MultibodyPlant, model_instance: ModelInstanceIndex) -> tuple[np.ndarray, np.ndarray]:
    """Where the four angles are in the model's state, and which flipper each of the model's actuators moves."""
    model = plant.GetModelInstanceName(model_instance)
    joint_names = [f"{flipper}_flipper_joint" for flipper in FLIPPERS]
    actuators = [plant.get_joint_actuator(i) for i in plant.GetJointActuatorIndices(model_instance)]
    actuated = [actuator.joint().name() for actuator in actuators]
    if sorted(actuated) != sorted(joint_names):
        raise ConfigError(
            "the model's actuated joints are not the four flippers", key=model, value=actuated, valid=joint_names
        )
    if without := [actuator.name() for actuator in actuators if not actuator.has_controller()]:
        raise ConfigError("actuators have no drake:controller_gains", key=model, value=without)
    positions = plant.GetPositionsFromArray(model_instance, np.arange(plant.num_positions(), dtype=float))
    joints = [plant.GetJointByName(name, model_instance) for name in joint_names]
    angle_indices = np.array([np.flatnonzero(positions == joint.position_start())[0] for joint in joints])
    return angle_indices, np.array([joint_names.index(name) for name in actuated])
