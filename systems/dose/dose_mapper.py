"""From readings of a gamma counter to the dose field, as a system."""

from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from ..config import check_config, quantity
from ..ports import eval_typed, weak_method
from ..sensing.gamma_counter import DoseReading
from .dose_estimate import DoseConfig, estimate_dose
from .dose_field import DoseField, DoseReadings


@dataclass(kw_only=True)
class DoseMapperConfig:
    """When readings are noted, and how they are understood."""

    # Interval at which a new reading and the pose are noted; shorter than the period of the counter.
    period: float = quantity(0.1, unit="s", above=0.0)
    # How long poses are remembered; longer than a reading takes.
    history: float = quantity(10.0, unit="s", above=0.0)
    # A reading whose middle is further than this from every remembered pose has no place.
    max_gap: float = quantity(0.5, unit="s", above=0.0)
    # How sources are looked for.
    dose: DoseConfig = field(default_factory=DoseConfig)


@dataclass(frozen=True, eq=False)
class _Noted:
    """Abstract state; read-only. `poses` are rows of time [s] and p_MG [m], rising in time."""

    readings: DoseReadings = field(default_factory=DoseReadings)
    poses: tuple[tuple[float, float, float, float], ...] = ()
    index: int = -1

    def __deepcopy__(self, memo: dict) -> "_Noted":
        return self


def position_at(poses: np.ndarray, time: float, max_gap: float) -> np.ndarray:
    """Position (3) at `time`, on the straight line between the nearest two poses, NaN where there are none.

    Args:
        poses: rows of time and position, (N, 4), rising in time. max_gap: to the nearer pose, at most [s].
    """
    if not len(poses) or np.abs(poses[:, 0] - time).min() > max_gap:
        return np.full(3, np.nan)
    return np.array([np.interp(time, poses[:, 0], poses[:, axis]) for axis in (1, 2, 3)])


class DoseMapper(LeafSystem):
    """
    .. pydrake_system::

        name: DoseMapper
        input_ports:
        - reading
        - X_MB
        - map_M
        output_ports:
        - readings
        - dose_field
        - sources
        - health

    Notes every `reading` (`DoseReading`) once, with the place where the counter was in the middle of it: the positions
    from `X_MB` (`RigidTransform`, pose of the base B in the map M) are remembered at every period. Readings without
    live time and those whose pose is unknown or not finite are noted, with a place of NaN, and not used.

    - `readings` (`DoseReadings`): all of them.
    - `dose_field` (`DoseField`): background, sources and the dose rate everywhere (`estimate_dose`). It is computed
      when it is asked for, in about a second, and kept until something changes.
    - `sources` (tuple of `SourceEstimate`): those of `dose_field`, the strongest first.
    - `health` (`DoseHealth`): that of `dose_field`, such as "few readings" or "ambiguous".
    - `map_M` (`PointCloud`), optional: the survey map, whose walls cast shadows. It is read only when `dose_field` is.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PortError: an input is not connected or of another type.
    """

    def __init__(self, config: DoseMapperConfig | None = None, *, X_BG: RigidTransform | None = None):
        """
        Args:
            X_BG: pose of the counter in the robot base; identity when not given.
        """
        super().__init__()
        self._config = config or DoseMapperConfig()
        check_config(self._config, where="dose_mapper")
        self._X_BG = X_BG or RigidTransform()
        self.DeclareAbstractInputPort("reading", AbstractValue.Make(object()))
        self.DeclareAbstractInputPort("X_MB", AbstractValue.Make(RigidTransform()))
        map_M = self.DeclareAbstractInputPort("map_M", AbstractValue.Make(object()))
        start = _Noted()
        state = self.abstract_state_ticket(self.DeclareAbstractState(AbstractValue.Make(start)))
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._config.period, 0.0, self._Note)
        needs = {state, self.input_port_ticket(map_M.get_index())}
        self.DeclareAbstractOutputPort(
            "readings", lambda: AbstractValue.Make(start.readings), weak_method(self._CalcReadings), {state}
        )
        for name, calc in (
            ("dose_field", self._CalcField),
            ("sources", self._CalcSources),
            ("health", self._CalcHealth),
        ):
            self.DeclareAbstractOutputPort(name, lambda: AbstractValue.Make(object()), weak_method(calc), needs)

    def _Note(self, context: Context, state: State) -> EventStatus:
        reading = eval_typed(self, context, "reading", DoseReading)
        p_MG = (eval_typed(self, context, "X_MB", RigidTransform) @ self._X_BG).translation()
        noted, now, config = self._noted(context), context.get_time(), self._config
        # Time that has gone back starts the poses anew; what was counted stays.
        poses = tuple(pose for pose in noted.poses if now - config.history <= pose[0] < now)
        if np.isfinite(p_MG).all():
            poses = (*poses, (now, float(p_MG[0]), float(p_MG[1]), float(p_MG[2])))
        noted = replace(noted, poses=poses)
        if reading.index > noted.index:
            middle = reading.time - reading.duration / 2
            known = noted.readings
            readings = DoseReadings(
                time=np.append(known.time, middle),
                counts=np.append(known.counts, reading.counts),
                live_time=np.append(known.live_time, reading.live_time),
                p_MG=np.vstack([known.p_MG, position_at(np.array(poses), middle, config.max_gap)]),
            )
            noted = replace(noted, readings=readings, index=reading.index)
        state.get_mutable_abstract_state(0).set_value(noted)
        return EventStatus.Succeeded()

    @staticmethod
    def _noted(context: Context) -> _Noted:
        held: Any = context.get_abstract_state(0)
        return held.get_value()

    def _field(self, context: Context) -> DoseField:
        """The field as the port has it, which Drake computes once for all that ask."""
        found: Any = self.GetOutputPort("dose_field").Eval(context)
        return cast(DoseField, found)

    def _CalcReadings(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._noted(context).readings)

    def _CalcField(self, context: Context, output: AbstractValue) -> None:
        points = None
        if self.GetInputPort("map_M").HasValue(context):
            cloud = eval_typed(self, context, "map_M", PointCloud)
            points = cloud.point.positions.numpy() if "positions" in cloud.point else None
        output.set_value(estimate_dose(self._noted(context).readings, self._config.dose, points))

    def _CalcSources(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._field(context).sources)

    def _CalcHealth(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._field(context).health)
