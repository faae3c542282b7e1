"""How fast the head of the snake moves, from its inertial measurement unit over some seconds."""

from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from ..config import check_config, quantity
from ..ports import eval_typed


@dataclass(kw_only=True)
class InertialSpeedConfig:
    """How long the unit's readings are believed."""

    # Time between two looks: that of the unit or a part of it. Contact makes the robot tremble faster.
    period: float = quantity(0.005, unit="s", above=0.0)
    # Wheels slower than this, commanded and measured, mean that the robot rests.
    rest_speed: float = quantity(0.01, unit="m/s", above=0.0)
    # What the unit reads at rest is learnt with this time constant.
    rest_window: float = quantity(0.3, unit="s", above=0.0)
    # Time constant with which the speed is drawn to that of the wheels: longer than it takes to get stuck, shorter
    # than it takes an accelerometer to be wrong.
    memory: float = quantity(12.0, unit="s", above=0.0)
    # Radius of the wheels.
    wheel_radius: float = quantity(0.05, unit="m", above=0.0)


def turned_gravity(force: np.ndarray, rate: np.ndarray, dt: float) -> np.ndarray:
    """What a vector that is fixed in the world, (3,) in the head's frame, is after turning at `rate` (3,) [rad/s]."""
    turned = force - dt * np.array(
        [
            rate[1] * force[2] - rate[2] * force[1],
            rate[2] * force[0] - rate[0] * force[2],
            rate[0] * force[1] - rate[1] * force[0],
        ]
    )
    length = np.sqrt(turned @ turned)
    return turned * (np.sqrt(force @ force) / length) if length > 0 else turned


# Layout of the discrete state.
_SPEED, _REST_FORCE, _REST_RATE = 0, slice(1, 4), slice(4, 7)


class InertialSpeed(LeafSystem):
    """
    .. pydrake_system::

        name: InertialSpeed
        input_ports:
        - gyro
        - accelerometer
        - wheel_speeds
        - wheel_speed_command
        output_ports:
        - forward_speed

    Speed of the head along its x axis, from the IMU that sits in it with its axes.

    - `gyro` (3) [rad/s], `accelerometer` (3) [m/s²].
    - `wheel_speeds`, `wheel_speed_command` (2n) [rad/s]: of n pairs of wheels.
    - `forward_speed` (1) [m/s].

    While the robot rests, the specific force and the rates that the unit reads are learnt, offsets included, and the
    speed is zero. When it drives, the force that was learnt turns with the gyroscopes, and the speed is the integral of
    what is measured beyond it, slowly drawn to the median speed of the wheels' rims. Good for some seconds after a
    rest, and for a jolt at any time; a robot that has slipped for longer than `memory` seems to drive.

    Raises `ConfigError` on values out of range and `PortError` when a port is not connected.
    """

    def __init__(self, config: InertialSpeedConfig, *, units: int):
        super().__init__()
        check_config(config, key="inertial_speed")
        self._config = config
        self._sizes = {"gyro": 3, "accelerometer": 3, "wheel_speeds": 2 * units, "wheel_speed_command": 2 * units}
        for name, size in self._sizes.items():
            self.DeclareVectorInputPort(name, size)
        self.DeclareDiscreteState(np.r_[0.0, 0.0, 0.0, 9.81, np.zeros(3)])
        self.DeclareVectorOutputPort("forward_speed", 1, self._CalcForwardSpeed, {self.xd_ticket()})
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, 0.0, self._Update)

    def _CalcForwardSpeed(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state_vector().value()[:1])

    def _Update(self, context: Context, discrete_state: DiscreteValues) -> None:
        config = self._config
        rate, force, wheels, command = (eval_typed(self, context, name, np.ndarray) for name in self._sizes)
        x = context.get_discrete_state_vector().value().copy()
        rim = float(np.median(wheels)) * config.wheel_radius
        if max(abs(rim), np.abs(command).max() * config.wheel_radius) < config.rest_speed:
            share = min(1.0, config.period / config.rest_window)
            x[_REST_FORCE] += share * (force - x[_REST_FORCE])
            x[_REST_RATE] += share * (rate - x[_REST_RATE])
            x[_SPEED] = 0.0
        else:
            x[_REST_FORCE] = turned_gravity(x[_REST_FORCE], rate - x[_REST_RATE], config.period)
            x[_SPEED] += config.period * (force[0] - x[_REST_FORCE][0])
            x[_SPEED] += config.period / config.memory * (rim - x[_SPEED])
        if np.all(np.isfinite(x)):  # a reading that is not a number is passed over
            discrete_state.set_value(x)
