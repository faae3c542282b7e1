"""Drives two wheels side by side: a twist or two speeds in, setpoints of the wheels' joints out."""

from dataclasses import dataclass

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import BasicVector, BusValue, Context, DiscreteValues, EventStatus, LeafSystem

from ..config import check_config, quantity
from ..ports import eval_typed, weak_method
from .setpoints import find_actuators, state_indices
from .track_driver import declare_command, read_command
from .track_speeds import limit_track_acceleration, limit_track_speeds

WHEELS = ("left_wheel", "right_wheel")
"""Links of the driven wheels; "{link}_joint" turns each, with a positive speed forward."""


@dataclass(kw_only=True)
class WheelDriverConfig:
    """Limits of the wheel drives, and the dimensions that they reckon with. Torques are limited by the model."""

    # [s] between two samples of the command.
    period: float = quantity(0.02, unit="s", above=0.0)
    # [m/s] largest speed of a wheel's rim. Assumed, for a Pioneer 3-DX.
    max_speed: float = quantity(1.2, unit="m/s", above=0.0)
    # [m/s^2] largest change of a rim's speed.
    max_acceleration: float = quantity(1.0, unit="m/s^2", above=0.0)
    # [m] distance of the wheels' middle planes.
    gauge: float = quantity(0.331, unit="m", above=0.0)
    # [m] radius of the wheels.
    wheel_radius: float = quantity(0.0975, unit="m", above=0.0)


# Layout of the discrete state: setpoints of the angles and of their rates, valid at `_TIME`.
_ANGLES, _RATES, _TIME = slice(0, 2), slice(2, 4), 4


class WheelDriver(LeafSystem):
    """
    .. pydrake_system::

        name: WheelDriver
        input_ports:
        - twist_command
        - track_speed_command
        - state
        output_ports:
        - wheel_setpoint
        - surface_displacements
        - commanded_track_speeds

    Drives of two wheels with limited speed and acceleration. Connect exactly one of `twist_command` (v [m/s],
    ω [rad/s]) of the base and `track_speed_command` (left, right) [m/s], the speeds of the rims. Commands are sampled,
    limited and, when not finite, taken as zero, as by `TrackDriver`. `state` is the plant's state of the model.

    `wheel_setpoint` (4) holds the angles (left, right) [rad] and rates [rad/s] for the position control of the joints.
    The angle moves on with the rate between samples. It never leads the wheel by more than what takes the whole torque
    of the motor: a wheel that was held back does not catch up afterwards. A command of zero holds the wheels where they
    are, up to that torque.

    `surface_displacements` is a bus as the plant's port of that name: how far the rim of every wheel has run [m] by
    scoped link name, for `TrackEncoders`. `commanded_track_speeds` (left, right) [m/s] depends on state only.

    Raises `ConfigError` for a value out of range or a model without these wheels, and `PortError` at the first sample
    when none or both of the commands are connected.
    """

    def __init__(self, config: WheelDriverConfig, plant: MultibodyPlant, model_instance: ModelInstanceIndex):
        super().__init__()
        check_config(config)
        self._config = config
        joints = [f"{wheel}_joint" for wheel in WHEELS]
        actuators = find_actuators(plant, model_instance, joints)
        self._lead = np.array([a.effort_limit() / a.get_controller_gains().p for a in actuators])
        self._indices = state_indices(plant, model_instance, joints)
        self._links = [plant.GetBodyByName(name, model_instance).scoped_name().get_full() for name in WHEELS]
        declare_command(self)
        state = self.DeclareVectorInputPort("state", plant.num_multibody_states(model_instance))
        self.DeclareDiscreteState(5)
        self.DeclareInitializationDiscreteUpdateEvent(self._Initialize)
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, 0.0, self._Update)
        self.DeclareVectorOutputPort(
            "wheel_setpoint",
            4,
            self._CalcSetpoint,
            prerequisites_of_calc={self.xd_ticket(), self.time_ticket()},
        )
        self.DeclareAbstractOutputPort(
            "surface_displacements",
            lambda: Value(BusValue()),
            weak_method(self._CalcDisplacements),
            prerequisites_of_calc={state.ticket()},
        )
        self.DeclareVectorOutputPort(
            "commanded_track_speeds", 2, self._CalcSpeeds, prerequisites_of_calc={self.xd_ticket()}
        )

    def _measured(self, context: Context) -> np.ndarray:
        return eval_typed(self, context, "state", np.ndarray)[self._indices]

    def _setpoint(self, context: Context) -> np.ndarray:
        """Angles now [rad]."""
        x = context.get_discrete_state_vector().value()
        angles: np.ndarray = x[_ANGLES] + x[_RATES] * (context.get_time() - x[_TIME])
        return angles

    def _Initialize(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        discrete_state.set_value(np.concatenate([self._measured(context), np.zeros(2), [context.get_time()]]))
        return EventStatus.Succeeded()

    def _Update(self, context: Context, discrete_state: DiscreteValues) -> None:
        config = self._config
        previous = context.get_discrete_state_vector().value()[_RATES] * config.wheel_radius
        target = limit_track_speeds(read_command(self, context, config.gauge), config.max_speed)
        speeds = limit_track_acceleration(previous, target, config.max_acceleration * config.period)
        measured = self._measured(context)
        angles = np.clip(self._setpoint(context), measured - self._lead, measured + self._lead)
        discrete_state.set_value(np.concatenate([angles, speeds / config.wheel_radius, [context.get_time()]]))

    def _CalcSetpoint(self, context: Context, output: BasicVector) -> None:
        rates = context.get_discrete_state_vector().value()[_RATES]
        output.SetFromVector(np.concatenate([self._setpoint(context), rates]))

    def _CalcDisplacements(self, context: Context, output: AbstractValue) -> None:
        bus = BusValue()
        for name, angle in zip(self._links, self._measured(context), strict=True):
            bus.Set(name, Value(float(angle * self._config.wheel_radius)))
        output.set_value(bus)

    def _CalcSpeeds(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state_vector().value()[_RATES] * self._config.wheel_radius)
