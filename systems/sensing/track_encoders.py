"""Encoders on the drive sprockets of two tracks."""

from dataclasses import dataclass

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import BasicVector, BusValue, Context, DiscreteValues, EventStatus, LeafSystem

from ..config import check_config, quantity
from ..errors import PortError
from ..ports import eval_typed


@dataclass(kw_only=True)
class TrackEncodersConfig:
    """Errors and rate of the encoders."""

    # [s] between two readings.
    period: float = quantity(0.02, unit="s", above=0.0)
    # [m] belt per count: 4 x 1024 counts on a sprocket of 0.08 m radius.
    resolution: float = quantity(1.2e-4, unit="m", above=0.0)
    # Standard deviation of each side's scale error (belt stretch and wear), relative; 0 for perfect encoders.
    scale_error_std: float = quantity(0.0, low=0.0, high=0.5)
    # Seed of the scale errors.
    seed: int = quantity(0, low=0)


def encoder_counts(displacements: np.ndarray, scale_errors: np.ndarray, resolution: float) -> np.ndarray:
    """Whole counts after the given belt displacements [m], read with relative errors of scale."""
    return np.rint(displacements * (1.0 + scale_errors) / resolution)


class TrackEncoders(LeafSystem):
    """
    .. pydrake_system::

        name: TrackEncoders
        input_ports:
        - surface_displacements
        output_ports:
        - track_displacements
        - track_speeds

    One encoder on each track. Every `period` it counts how far the belt has run (`encoder_counts`) on the plant's
    `surface_displacements` bus, in steps of `resolution` and with a scale error that is drawn once per side. Encoders
    see the belt, not the ground: slip is not in them. `track_displacements` is (left, right) [m] since the plant's
    start, `track_speeds` (left, right) [m/s] the difference of the last two readings, in steps of resolution / period.

    Raises `ConfigError` for a value out of range, `PortError` when the bus is missing or lacks a track.
    """

    def __init__(
        self,
        config: TrackEncodersConfig,
        left_surface: str = "crawler::left_track",
        right_surface: str = "crawler::right_track",
    ):
        """Reads the surfaces with the given scoped link names."""
        super().__init__()
        check_config(config)
        self._config = config
        self._surfaces = (left_surface, right_surface)
        self.scale_errors = np.random.default_rng(config.seed).normal(0.0, config.scale_error_std, 2)
        self.DeclareAbstractInputPort("surface_displacements", Value(BusValue()))
        self.DeclareDiscreteState(4)  # displacements, then speeds
        self.DeclareInitializationDiscreteUpdateEvent(self._Initialize)
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, 0.0, self._Update)
        state = {self.xd_ticket()}
        self.DeclareVectorOutputPort("track_displacements", 2, self._CalcDisplacements, prerequisites_of_calc=state)
        self.DeclareVectorOutputPort("track_speeds", 2, self._CalcSpeeds, prerequisites_of_calc=state)

    def _read(self, context: Context) -> np.ndarray:
        bus = eval_typed(self, context, "surface_displacements", BusValue)
        displacements = [bus.Find(name) for name in self._surfaces]
        if None in displacements:
            where = f"{type(self).__name__}.surface_displacements"
            raise PortError("the bus lacks a track", where=where, value=list(bus), valid=self._surfaces)
        return (
            encoder_counts(np.array(displacements), self.scale_errors, self._config.resolution)
            * self._config.resolution
        )

    def _Initialize(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        discrete_state.set_value(np.concatenate([self._read(context), np.zeros(2)]))
        return EventStatus.Succeeded()

    def _Update(self, context: Context, discrete_state: DiscreteValues) -> None:
        previous = context.get_discrete_state_vector().value()[:2]
        displacements = self._read(context)
        speeds = (displacements - previous) / self._config.period
        discrete_state.set_value(np.concatenate([displacements, speeds]))

    def _CalcDisplacements(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state_vector().value()[:2])

    def _CalcSpeeds(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state_vector().value()[2:])
