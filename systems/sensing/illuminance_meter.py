"""Simulated illuminance meter under lamps and windows (row S4-g)."""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import FrameId, QueryObject
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from ..config import check_config, quantity
from ..noise import generator_at
from ..ports import eval_typed
from .lamps import Emitters, illuminance
from .ray_scene import RayScene


@dataclass(kw_only=True)
class IlluminanceMeterConfig:
    """Errors and rate of the meter. Assumed: within what JIS C 1609-1 allows a meter of class AA, 4 %."""

    # [s] between two readings.
    period: float = quantity(0.5, unit="s", above=0.0)
    # Standard deviation of the error of scale, one for the whole run, relative.
    scale_error_std: float = quantity(0.01, low=0.0, high=0.5)
    # Standard deviation of a reading, relative, and of its zero [lux].
    noise: float = quantity(0.005, low=0.0, high=0.5)
    zero_noise: float = quantity(0.05, unit="lux", low=0.0)
    # [lux] step of the display.
    resolution: float = quantity(0.1, unit="lux", above=0.0)


def read_meter(true: float, scale_error: float, rng: np.random.Generator, config: IlluminanceMeterConfig) -> float:
    """What the meter shows for a true illuminance [lux]; two numbers are drawn."""
    factor, zero = rng.standard_normal(2)
    shown = true * (1 + scale_error) * (1 + config.noise * factor) + config.zero_noise * zero
    return max(round(shown / config.resolution) * config.resolution, 0.0)


class IlluminanceMeter(LeafSystem):
    """
    .. pydrake_system::

        name: IlluminanceMeter
        input_ports:
        - geometry_query
        output_ports:
        - illuminance
        - cheat.illuminance

    A plate that measures the light which falls on it from lamps and windows, see `lamps.illuminance`: inverse square,
    cosine law of plate and source, and what stands between. Its response to the angle of incidence is the ideal cosine.

    - `geometry_query` (QueryObject): the SceneGraph's `query` port, for the poses of the frames.
    - `illuminance` (1): the last reading [lux], with the errors of the configuration, held for a `period`; 0 before
      the first.
    - `cheat.illuminance` (1): the true illuminance now [lux].

    Args:
        config: of the meter.
        emitters: lamps and windows, see `make_emitters`.
        scene: what can be in the way; build it once, sensors can share it.
        parent_frame: SceneGraph frame P that the meter is fixed to.
        X_PI: pose of the meter's frame I in P: its origin is the middle of the plate, its z axis the normal.
        own_frames: frames of the robot: they cast no shadow on the meter.
        seed: of the errors; two runs with one seed are equal.

    Raises:
        ConfigError: a value of `config` is out of its range.
        PortError: `geometry_query` is not connected.
    """

    def __init__(
        self,
        config: IlluminanceMeterConfig,
        *,
        emitters: Emitters,
        scene: RayScene,
        parent_frame: FrameId,
        X_PI: RigidTransform,
        own_frames: Collection[FrameId] = (),
        seed: int = 0,
    ):
        super().__init__()
        check_config(config, where="illuminance_meter")
        self._config, self._emitters, self._scene = config, emitters, scene
        self._parent_frame, self._X_PI, self._seed = parent_frame, X_PI, seed
        own = {parent_frame, *own_frames}
        self._moving_frames = [frame for frame in scene.moving_frames if frame not in own]
        # The streams of the readings begin at 1.
        self._scale_error = config.scale_error_std * float(generator_at(seed, 0).standard_normal())
        self.DeclareAbstractInputPort("geometry_query", AbstractValue.Make(QueryObject()))
        self.DeclareDiscreteState(2)  # the reading [lux], and how many there were
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, 0.0, self._Read)
        self.DeclareVectorOutputPort("illuminance", 1, self._CalcReading, {self.xd_ticket()})
        self.DeclareVectorOutputPort("cheat.illuminance", 1, self._CalcTruth)

    def illuminance_at(self, context: Context, places: np.ndarray) -> np.ndarray:
        """True illuminance now of the plate as it is, were it carried to other places, (n,) [lux]; for metrics.

        Args:
            places: (n, 2) x and y in W [m]; height and tilt stay.
        """
        X_WI, X_WF = self._poses(context)
        p_WP = np.column_stack([places, np.full(len(places), X_WI.translation()[2])])
        return illuminance(p_WP, X_WI.rotation().matrix()[:, 2], self._emitters, self._scene, X_WF)

    def _truth(self, context: Context) -> float:
        X_WI, X_WF = self._poses(context)
        normal = X_WI.rotation().matrix()[:, 2]
        return float(illuminance(X_WI.translation(), normal, self._emitters, self._scene, X_WF)[0])

    def _poses(self, context: Context) -> tuple[RigidTransform, dict[FrameId, RigidTransform]]:
        """Of the plate, and of what moves, in W."""
        query = eval_typed(self, context, "geometry_query", QueryObject)
        X_WF = {frame: query.GetPoseInWorld(frame) for frame in self._moving_frames}
        return query.GetPoseInWorld(self._parent_frame) @ self._X_PI, X_WF

    def _Read(self, context: Context, discrete_state: DiscreteValues) -> None:
        count = int(context.get_discrete_state_vector().GetAtIndex(1)) + 1
        shown = read_meter(self._truth(context), self._scale_error, generator_at(self._seed, count), self._config)
        discrete_state.set_value(np.array([shown, count]))

    def _CalcReading(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, context.get_discrete_state_vector().GetAtIndex(0))

    def _CalcTruth(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self._truth(context))
