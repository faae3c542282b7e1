"""Range sensors along the snake: lines of time-of-flight zones that look down from the belly and out to both sides."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from ..config import check_config, quantity
from ..noise import generator_at
from ..ports import eval_typed
from ..sensing import RayScene

# Sides of a half of a unit that look out, in the order in which `ranges` lists them.
RANGE_SIDES = ("belly", "left", "right")


@dataclass(kw_only=True)
class RangeSensorsConfig:
    """Values are assumed, of the order of small time-of-flight sensors with several zones."""

    # Time between samples.
    period: float = quantity(0.05, unit="s", above=0.0)
    # Zones of a sensor, evenly spaced along its half of the unit.
    zones: int = quantity(9, low=1)
    # What is farther, or not there, reads as this.
    max_range: float = quantity(0.3, unit="m", above=0.0)
    # What is nearer reads as this.
    min_range: float = quantity(0.001, unit="m", low=0.0)
    # Standard deviation of a reading.
    noise_std: float = quantity(0.001, unit="m", low=0.0)


@dataclass(frozen=True, kw_only=True)
class HalfShape:
    """Where the sensors sit on a half of a unit, in its link frame L (x ahead, origin at its front joint).

    Attributes:
        length: of the half [m]. belly: depth of the belly below the joint axes [m]. side: distance of the sides [m].
    """

    length: float
    belly: float
    side: float


def zone_rays(shape: HalfShape, zones: int) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions of one half's rays in L, each (3, zones, 3), the sides in the order of `RANGE_SIDES`."""
    x = -shape.length * (np.arange(zones) + 0.5) / zones
    origin, direction = np.zeros((3, zones, 3)), np.zeros((3, zones, 3))
    origin[..., 0] = x
    origin[0, :, 2], direction[0, :, 2] = -shape.belly, -1.0
    origin[1, :, 1], direction[1, :, 1] = shape.side, 1.0
    origin[2, :, 1], direction[2, :, 1] = -shape.side, -1.0
    return origin, direction


class RangeSensors(LeafSystem):
    """
    .. pydrake_system::

        name: RangeSensors
        input_ports:
        - body_poses
        output_ports:
        - ranges

    Lines of range sensors on both halves of each of n units. `body_poses` is the plant's output port of this name.
    `ranges` (2n × 3 × zones, flattened) [m]: for every half from the head on (front and rear half of unit 0, of unit
    1, ...), for every side of `RANGE_SIDES`, the zones from front to back. They see what never moves in `scene`, not
    the robot itself. A zone that sees nothing within `max_range` reads that.

    Sampled every period from t = 0 on and held between; `max_range` before the first sample.

    Args:
        config: range and noise.
        scene: what is seen.
        halves: indices of the links in `body_poses`, 2n from the head on.
        shape: where the sensors sit, the same on all halves.
        seed: of the noise; two runs with one seed are equal.

    Raises `ConfigError` on values out of range and `PortError` when the port is not connected.
    """

    def __init__(
        self,
        config: RangeSensorsConfig,
        *,
        scene: RayScene,
        halves: Sequence[int],
        shape: HalfShape,
        seed: int = 0,
    ):
        super().__init__()
        check_config(config, key="ranges")
        self._config, self._scene, self._seed = config, scene, seed
        self._halves = [int(i) for i in halves]
        self._origin_L, self._direction_L = (rays.reshape(-1, 3) for rays in zone_rays(shape, config.zones))
        count = len(self._halves) * len(self._origin_L)
        self.DeclareAbstractInputPort("body_poses", AbstractValue.Make([RigidTransform()]))
        self.DeclareDiscreteState(np.r_[np.full(count, config.max_range), 0.0])  # readings, then the samples
        self.DeclareVectorOutputPort("ranges", count, self._CalcRanges, {self.xd_ticket()})
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, 0.0, self._Sample)

    def _CalcRanges(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state_vector().value()[:-1])

    def _Sample(self, context: Context, discrete_state: DiscreteValues) -> None:
        poses = eval_typed(self, context, "body_poses", list)
        matrices = np.array([poses[i].GetAsMatrix34() for i in self._halves])
        R, p = matrices[:, :, :3], matrices[:, :, 3]
        origin = np.einsum("hij,rj->hri", R, self._origin_L) + p[:, None]
        direction = np.einsum("hij,rj->hri", R, self._direction_L)
        hits = self._scene.cast(origin.reshape(-1, 3), direction.reshape(-1, 3))
        sample = int(context.get_discrete_state_vector().value()[-1]) + 1
        config = self._config
        noise = config.noise_std * generator_at(self._seed, sample).standard_normal(len(hits.distance))
        seen = hits.distance < config.max_range
        reading = np.where(seen, np.clip(hits.distance + noise, config.min_range, config.max_range), config.max_range)
        discrete_state.set_value(np.r_[reading, sample])
