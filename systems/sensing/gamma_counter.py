"""Simulated gamma counter: dose rate from sources behind walls, and the counts that say how much it is."""

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import FrameId, QueryObject
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, LeafSystem, State
from scipy.special import gammainc

from ..config import check_config, quantity
from ..noise import generator_at
from ..ports import eval_typed, weak_method
from .ray_scene import RayScene, RaySource

# Ambient dose rate of 1 MBq of Cs-137 (662 keV) at 1 m in air [uSv/h m²/MBq], the commonly tabulated value.
GAMMA_CS137 = 0.0927
# A source is not a point: nearer than this, the dose rate does not grow further [m].
MIN_DISTANCE = 0.1


@dataclass(kw_only=True)
class GammaCounterConfig:
    """A counter that knows no directions and no energies, such as a small scintillator."""

    # Time over which one reading counts.
    period: float = quantity(0.5, unit="s", above=0.0)
    # Counts per dose rate. Assumed; some 1500 for a NaI scintillator of 2 x 2 inches, some 300 for one of 1 inch.
    sensitivity: float = quantity(1000.0, unit="(counts/s)/(uSv/h)", above=0.0)
    # Dose rate without any source.
    background: float = quantity(0.1, unit="uSv/h", low=0.0)
    # Time after a count in which nothing is counted, and which is not extended by what arrives in it.
    dead_time: float = quantity(5e-6, unit="s", low=0.0)


@dataclass(frozen=True)
class DoseReading:
    """One reading of a gamma counter.

    Attributes:
        counts: how many were counted.
        live_time: duration less the dead time of the counts [s].
        dose_rate: counts / live time / sensitivity, background included [uSv/h].
        sigma: standard deviation of it from the counts alone, that of one count when there is none [uSv/h].
        time: end of the reading [s].
        duration: of the reading [s].
        index: from 0; -1 before there is a reading.
    """

    counts: int
    live_time: float
    dose_rate: float
    sigma: float
    time: float
    duration: float
    index: int

    def __deepcopy__(self, memo: dict) -> "DoseReading":
        return self


NO_READING = DoseReading(0, 0.0, 0.0, 0.0, 0.0, 0.0, -1)


def source_dose_rate(activity: np.ndarray, distance: np.ndarray, optical_depth: np.ndarray) -> np.ndarray:
    """Dose rate of point sources of Cs-137, Γ A exp(−τ) / r² [uSv/h].

    τ is that of the unscattered rays. What is scattered on the way and arrives all the same (build-up) is not in it,
    so behind thick walls the true dose rate would be a few times higher.

    Args:
        activity: A [MBq]. distance: r [m], at least `MIN_DISTANCE` counts. optical_depth: τ.
    """
    return GAMMA_CS137 * activity * np.exp(-optical_depth) / np.maximum(distance, MIN_DISTANCE) ** 2


def counts_from_uniform(uniform: float, rate: float, duration: float, dead_time: float) -> int:
    """Number of counts in a time, the quantile at `uniform` of its exact distribution.

    Events come at `rate` [1/s] at random and independently; after each count the counter is blind for `dead_time` [s].
    So k counts or more fit when k exponential waiting times and k − 1 dead times do, which has the probability
    P(k, rate (duration − (k − 1) dead_time)) with P the regularised lower incomplete gamma function.
    """

    def at_least(k: int) -> float:
        alive = duration - (k - 1) * dead_time
        return float(gammainc(k, rate * alive)) if alive > 0 else 0.0

    low, high = 0, 1
    while at_least(high) > uniform:
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if at_least(middle) > uniform else (low, middle)
    return low


@dataclass(frozen=True)
class _Counting:
    """Abstract state; read-only. `rate` is the dose rate at `time`, when the reading in progress began."""

    reading: DoseReading = NO_READING
    time: float | None = None
    rate: float = 0.0

    def __deepcopy__(self, memo: dict) -> "_Counting":
        return self


class GammaCounter(LeafSystem):
    """
    .. pydrake_system::

        name: GammaCounter
        input_ports:
        - geometry_query
        output_ports:
        - reading
        - cheat.dose_rate

    Counts the gamma rays of the scene's sources: those geometries whose `Surface.activity` is above 0, each as a point
    at its centre. The dose rate is the background plus `source_dose_rate` of each, with the optical depth of all
    solids between source and counter (`RayScene.attenuation_along`), which may include the source's own body.

    - `geometry_query` (QueryObject): the SceneGraph's `query` port, for the poses of the frames.
    - `reading` (`DoseReading`): the last whole period, held until the next. Its counts have the dead time of a
      non-paralysable counter, the mean dose rate being that of the poses at the start and at the end.
    - `cheat.dose_rate` (1): the true dose rate now [uSv/h], background included.

    The first event notes the dose rate and the next one, at t = period in a run from 0, is the first reading. Until
    then the output is `NO_READING`. The same happens when time has jumped.

    Args:
        config: of the counter.
        scene: geometry with surface properties; build it once, sensors can share it.
        parent_frame: SceneGraph frame P that the counter is fixed to.
        X_PG: pose of the counter's frame G in P.
        own_frames: frames of the robot: its bodies do not attenuate.
        seed: of the counts; two runs with one seed are equal.

    Raises:
        ConfigError: a value of `config` is out of its range.
        PortError: `geometry_query` is not connected.
    """

    def __init__(
        self,
        config: GammaCounterConfig,
        *,
        scene: RayScene,
        parent_frame: FrameId,
        X_PG: RigidTransform,
        own_frames: Collection[FrameId] = (),
        seed: int = 0,
    ):
        super().__init__()
        check_config(config, where="gamma_counter")
        self._config = config
        self._scene = scene
        self._parent_frame = parent_frame
        self._X_PG = X_PG
        self._seed = seed
        own = {parent_frame, *own_frames}
        self._moving_frames = [frame for frame in scene.moving_frames if frame not in own]
        self._activity = np.array([source.activity for source in scene.sources])
        self.DeclareAbstractInputPort("geometry_query", AbstractValue.Make(QueryObject()))
        state = self.abstract_state_ticket(self.DeclareAbstractState(AbstractValue.Make(_Counting())))
        self.DeclareAbstractOutputPort(
            "reading", lambda: AbstractValue.Make(NO_READING), weak_method(self._CalcReading), {state}
        )
        self.DeclareVectorOutputPort("cheat.dose_rate", 1, self._CalcDoseRate)
        self.DeclarePeriodicUnrestrictedUpdateEvent(config.period, 0.0, self._FinishReading)

    def _CalcReading(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._counting(context).reading)

    def _CalcDoseRate(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self._dose_rate(context))

    @staticmethod
    def _counting(context: Context) -> _Counting:
        held: Any = context.get_abstract_state(0)
        return held.get_value()

    def _dose_rate(self, context: Context) -> float:
        """The true dose rate now [uSv/h]."""
        query = eval_typed(self, context, "geometry_query", QueryObject)
        if not len(self._activity):
            return self._config.background
        p_WG = (query.GetPoseInWorld(self._parent_frame) @ self._X_PG).translation()
        p_WQ = np.array([_centre(source, query) for source in self._scene.sources])
        X_WF = {frame: query.GetPoseInWorld(frame) for frame in self._moving_frames}
        depth = self._scene.attenuation_along(p_WQ, p_WG, X_WF)
        rates = source_dose_rate(self._activity, np.linalg.norm(p_WQ - p_WG, axis=1), depth)
        return self._config.background + float(rates.sum())

    def _FinishReading(self, context: Context, state: State) -> None:
        config, now, rate = self._config, context.get_time(), self._dose_rate(context)
        counting = self._counting(context)
        following = replace(counting, time=now, rate=rate)
        if counting.time is not None and abs(now - counting.time - config.period) < 1e-6 * config.period:
            index = counting.reading.index + 1
            mean_rate = config.sensitivity * (counting.rate + rate) / 2
            uniform = generator_at(self._seed, index).random()
            counts = counts_from_uniform(uniform, mean_rate, config.period, config.dead_time)
            following = replace(following, reading=make_reading(counts, now, index, config))
        state.get_mutable_abstract_state(0).set_value(following)


def _centre(source: RaySource, query: QueryObject) -> np.ndarray:
    X_WF = RigidTransform() if source.frame is None else query.GetPoseInWorld(source.frame)
    return (X_WF @ RigidTransform(np.array(source.p_FQ))).translation()


def make_reading(counts: int, time: float, index: int, config: GammaCounterConfig) -> DoseReading:
    """The reading of a counter that counted `counts` in the period that ended at `time` [s].

    A counter that is blind all the time has no live time, and an infinite dose rate.
    """
    live_time = max(config.period - counts * config.dead_time, 0.0)
    scale = 1 / (live_time * config.sensitivity) if live_time > 0 else np.inf
    return DoseReading(
        counts=counts,
        live_time=live_time,
        dose_rate=counts * scale if counts else 0.0,
        sigma=max(counts, 1) ** 0.5 * scale,
        time=time,
        duration=config.period,
        index=index,
    )
