"""Drives the belts of a tracked robot: a twist or two track speeds in, surface speeds for the plant out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import BusValue, Context, DiscreteValues, LeafSystem

from ..config import check_config, quantity
from ..errors import PortError
from ..ports import eval_typed, weak_method
from .track_speeds import limit_track_acceleration, limit_track_speeds, twist_to_track_speeds


@dataclass(kw_only=True)
class TrackDriverConfig:
    """Limits of the track drives."""

    # [s] between two samples of the command; drives of this class take commands at 50 Hz.
    period: float = quantity(0.02, unit="s", above=0.0)
    # [m/s] largest speed of a belt. The source's robot is specified at 0.1 m/s (S2); comparable ones do 0.4 to 3 m/s.
    max_speed: float = quantity(0.3, unit="m/s", above=0.0)
    # [m/s^2] largest change of a belt's speed, small enough that belts do not slip on starting.
    max_acceleration: float = quantity(0.5, unit="m/s^2", above=0.0)
    # [m] effective gauge: scrubbing belts turn as if they were this far apart. `skid_steer.effective_gauge` gives
    # 0.472 m for the 80 mm belts (0.24 m apart, 0.46 m long) and 0.468 m for the 40 mm ones (0.28 m apart).
    gauge: float = quantity(0.47, unit="m", above=0.0)


def declare_command(system: LeafSystem) -> None:
    """Declares the two inputs of `read_command`."""
    system.DeclareVectorInputPort("twist_command", 2)
    system.DeclareVectorInputPort("track_speed_command", 2)


def read_command(system: LeafSystem, context: Context, gauge: float) -> np.ndarray:
    """The commanded speeds (left, right) [m/s] before any limit; zero for a command that is not finite.

    Raises:
        PortError: none or both of `twist_command` and `track_speed_command` are connected.
    """
    by_twist, by_speeds = (
        system.GetInputPort(name).HasValue(context) for name in ("twist_command", "track_speed_command")
    )
    if by_twist == by_speeds:
        raise PortError(
            "both inputs are connected" if by_twist else "no input is connected",
            where=system.get_name() or type(system).__name__,
            valid="exactly one of twist_command and track_speed_command",
        )
    if by_twist:
        speed, yaw_rate = eval_typed(system, context, "twist_command", np.ndarray)
        speeds = twist_to_track_speeds(speed, yaw_rate, gauge)
    else:
        speeds = eval_typed(system, context, "track_speed_command", np.ndarray)
    return speeds if np.isfinite(speeds).all() else np.zeros(2)


class TrackDriver(LeafSystem):
    """
    .. pydrake_system::

        name: TrackDriver
        input_ports:
        - twist_command
        - track_speed_command
        output_ports:
        - surface_speeds
        - commanded_track_speeds

    Track drives with limited speed and acceleration. Connect exactly one of the inputs: `twist_command` (v [m/s],
    ω [rad/s]) of the base, or `track_speed_command` (left, right) [m/s]. Every `period` the command is turned into
    track speeds (`twist_to_track_speeds`), scaled to `max_speed` with its curvature kept, and approached with at most
    `max_acceleration`.

    A command of zero brings the belts to rest and holds them there: a belt at rest is a brake. A command with a NaN or
    an infinite entry counts as zero, so a broken source stops the robot with the ordinary deceleration; it drives
    again with the next finite command. Belts are at rest at the start.

    `surface_speeds` is the bus that `MultibodyPlant` takes: the speed [m/s] of every driven surface by scoped link
    name, the flippers with the track of their side. `commanded_track_speeds` is (left, right) [m/s]. Both depend on
    state only.

    Raises `ConfigError` for a value out of range, and `PortError` at the first sample when none or both of the inputs
    are connected.
    """

    def __init__(
        self, config: TrackDriverConfig, left_surfaces: Sequence[str] = (), right_surfaces: Sequence[str] = ()
    ):
        """Drives the links with the given scoped names, for example "crawler::left_track", on either side."""
        super().__init__()
        check_config(config)
        self._config = config
        self._surfaces = (*((name, 0) for name in left_surfaces), *((name, 1) for name in right_surfaces))
        declare_command(self)
        self._track_speeds = self.DeclareDiscreteState(2)
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, 0.0, self._Update)
        self.DeclareAbstractOutputPort(
            "surface_speeds",
            lambda: Value(BusValue()),
            weak_method(self._CalcSurfaceSpeeds),
            prerequisites_of_calc={self.xd_ticket()},
        )
        self.DeclareStateOutputPort("commanded_track_speeds", self._track_speeds)

    def _Update(self, context: Context, discrete_state: DiscreteValues) -> None:
        target = limit_track_speeds(read_command(self, context, self._config.gauge), self._config.max_speed)
        previous = context.get_discrete_state_vector().value()
        max_change = self._config.max_acceleration * self._config.period
        discrete_state.set_value(limit_track_acceleration(previous, target, max_change))

    def _CalcSurfaceSpeeds(self, context: Context, output: AbstractValue) -> None:
        speeds = context.get_discrete_state_vector().value()
        bus = BusValue()
        for name, side in self._surfaces:
            bus.Set(name, Value(float(speeds[side])))
        output.set_value(bus)
