"""Visits the points of a route and measures at some of them (row S4-g)."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, LeafSystem, State

from ..config import check_config, quantity
from ..errors import ConfigError
from ..ports import eval_typed, weak_method
from ..tracking import planar_pose


@dataclass(kw_only=True)
class MeasuringTourConfig:
    """When a point counts as reached, and how it is measured."""

    # [m] The robot stops for a measurement when it believes to be this near to the point; the paper's took 0.1 m.
    tolerance: float = quantity(0.04, unit="m", above=0)
    # [m] A point on the way only counts as passed within this, or when the robot is past it.
    pass_radius: float = quantity(0.6, unit="m", above=0)
    # [s] After it has stopped the robot waits, then takes the mean of the meter's readings over the second time.
    settle_time: float = quantity(1.0, unit="s", low=0)
    dwell_time: float = quantity(2.0, unit="s", above=0)
    # [s] A point that is not reached for so long is given up, and the next one is taken.
    patience: float = quantity(90.0, unit="s", above=0)
    # [s] between two decisions.
    period: float = quantity(0.1, unit="s", above=0)


@dataclass(frozen=True)
class Measurement:
    """What was measured at a point.

    Attributes:
        stop: which of the tour's stops, from 0.
        time: when the measurement ended [s].
        x, y: where the robot believed to be then, in M [m].
        illuminance: mean of the readings [lux]; deviation: of the readings. readings: how many.
    """

    stop: int
    time: float
    x: float
    y: float
    illuminance: float
    deviation: float
    readings: int


@dataclass(frozen=True)
class TourState:
    """Where the tour stands. Read-only.

    Attributes:
        index: of the route's point that the robot drives to; beyond the last when it is done.
        since: when it set out for it, or stopped there [s]; None before the first step.
        stopped: whether it stands there to measure.
        readings: of the meter since it settled [lux].
        measurements: so far. given_up: stops that could not be reached.
    """

    index: int = 0
    since: float | None = None
    stopped: bool = False
    readings: tuple[float, ...] = ()
    measurements: tuple[Measurement, ...] = ()
    given_up: tuple[int, ...] = ()

    def __deepcopy__(self, memo: dict) -> "TourState":
        return self


def tour_step(
    state: TourState,
    time: float,
    position: np.ndarray,
    reading: float,
    route: np.ndarray,
    stops: np.ndarray,
    config: MeasuringTourConfig,
) -> TourState:
    """The tour one decision later.

    Args:
        time: now [s]. position: (2,) where the robot believes to be [m]. reading: of the meter [lux].
        route: (p, 2) points to drive to, in order [m]. stops: (n,) rising indices of those at which it measures.
    """
    since = time if state.since is None else state.since
    state = replace(state, since=since)
    if state.index >= len(route):
        return state
    stop = int(np.searchsorted(stops, state.index))
    measures = stop < len(stops) and stops[stop] == state.index
    if state.stopped:
        waited = time - since
        if waited >= config.settle_time - 1e-9:
            state = replace(state, readings=(*state.readings, reading))
        if waited < config.settle_time + config.dwell_time - 1e-9:
            return state
        mean, deviation = float(np.mean(state.readings)), float(np.std(state.readings))
        taken = Measurement(stop, time, float(position[0]), float(position[1]), mean, deviation, len(state.readings))
        return _next(replace(state, measurements=(*state.measurements, taken)), time)
    away = float(np.hypot(*(route[state.index] - position)))
    if measures and away <= config.tolerance:
        return replace(state, stopped=True, since=time, readings=())
    if not measures and (away <= config.pass_radius or _is_past(position, state.index, route)):
        return _next(state, time)
    if time - since > config.patience:
        given_up = (*state.given_up, stop) if measures else state.given_up
        return _next(replace(state, given_up=given_up), time)
    return state


def _next(state: TourState, time: float) -> TourState:
    return replace(state, index=state.index + 1, since=time, stopped=False, readings=())


def _is_past(position: np.ndarray, index: int, route: np.ndarray) -> bool:
    """Whether the robot is beyond the point, seen along the leg that follows, and nearer to that leg's end."""
    if index + 1 >= len(route):
        return False
    leg = route[index + 1] - route[index]
    return bool((position - route[index]) @ leg > 0 and np.hypot(*(route[index + 1] - position)) < np.hypot(*leg))


class MeasuringTour(LeafSystem):
    """
    .. pydrake_system::

        name: MeasuringTour
        input_ports:
        - X_MB
        - illuminance
        - lost
        output_ports:
        - goal
        - stop
        - status
        - tour

    Leads a robot along a route and lets it stand and measure at its stops: see `tour_step`.

    - `X_MB` (RigidTransform): where the robot believes to be, in the map M.
    - `illuminance` (1): reading of the meter [lux].
    - `lost` (1), optional: above 0.5 the robot does not know where it is, and stands until it does.
    - `goal` (2): the point to drive to now, in M [m]; the last one when the tour is done.
    - `stop` (1): 1 while the robot is to stand, else 0.
    - `status` (str): "driving", "measuring", "lost" or "done".
    - `tour` (`TourState`): where the tour stands, with all measurements.

    Raises:
        ConfigError: a value is out of range, the route has no point, or the stops are not rising indices of it.
        PortError: `X_MB` is not connected or of another type.
    """

    def __init__(self, config: MeasuringTourConfig, route: np.ndarray, stops: np.ndarray):
        super().__init__()
        check_config(config, where="measuring_tour")
        self._config = config
        self._route = np.array(route, float).reshape(-1, 2)
        self._stops = np.array(stops, int).reshape(-1)
        if not len(self._route) or not np.isfinite(self._route).all():
            raise ConfigError("no route", where="measuring_tour", key="route", valid="points x, y [m]")
        inside = (self._stops >= 0).all() and (self._stops < len(self._route)).all()
        if not inside or (np.diff(self._stops) <= 0).any():
            valid = f"rising, 0 to {len(self._route) - 1}"
            raise ConfigError("stops", where="measuring_tour", key="stops", value=self._stops.tolist(), valid=valid)
        self.DeclareAbstractInputPort("X_MB", AbstractValue.Make(RigidTransform()))
        self.DeclareVectorInputPort("illuminance", 1)
        lost = self.DeclareVectorInputPort("lost", 1).ticket()
        state = self.abstract_state_ticket(self.DeclareAbstractState(AbstractValue.Make(TourState())))
        self.DeclarePeriodicUnrestrictedUpdateEvent(config.period, 0.0, self._Step)
        self.DeclareVectorOutputPort("goal", 2, self._CalcGoal, {state})
        self.DeclareVectorOutputPort("stop", 1, self._CalcStop, {state, lost})
        self.DeclareAbstractOutputPort(
            "status", lambda: AbstractValue.Make(""), weak_method(self._CalcStatus), prerequisites_of_calc={state, lost}
        )
        self.DeclareAbstractOutputPort(
            "tour", lambda: AbstractValue.Make(TourState()), weak_method(self._CalcTour), prerequisites_of_calc={state}
        )

    @staticmethod
    def _tour(context: Context) -> TourState:
        held: Any = context.get_abstract_state(0)
        tour: TourState = held.get_value()
        return tour

    def _Step(self, context: Context, state: State) -> None:
        position = planar_pose(eval_typed(self, context, "X_MB", RigidTransform))[:2]
        reading = float(eval_typed(self, context, "illuminance", np.ndarray)[0])
        tour = self._tour(context)
        moved = tour_step(tour, context.get_time(), position, reading, self._route, self._stops, self._config)
        state.get_mutable_abstract_state(0).set_value(moved)

    def _is_done(self, context: Context) -> bool:
        return self._tour(context).index >= len(self._route)

    def _is_lost(self, context: Context) -> bool:
        connected = self.GetInputPort("lost").HasValue(context)
        return connected and bool(eval_typed(self, context, "lost", np.ndarray)[0] > 0.5)

    def _CalcGoal(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._route[min(self._tour(context).index, len(self._route) - 1)])

    def _CalcStop(self, context: Context, output: BasicVector) -> None:
        stands = self._tour(context).stopped or self._is_done(context) or self._is_lost(context)
        output.SetAtIndex(0, float(stands))

    def _CalcStatus(self, context: Context, output: AbstractValue) -> None:
        moving = "measuring" if self._tour(context).stopped else "driving"
        under_way = "lost" if self._is_lost(context) else moving
        output.set_value("done" if self._is_done(context) else under_way)

    def _CalcTour(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._tour(context))
