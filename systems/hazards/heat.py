"""What is hotter than its surroundings, in 3D."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, LeafSystem
from scipy.spatial import KDTree
from scipy.special import expit

from ..config import check_config, quantity
from ..ports import eval_typed, weak_method
from .regions import HotSpot, RegionConfig, find_regions
from .water import cloud_attribute, cloud_points

# Standard deviation of a normal distribution over its median absolute deviation.
_MAD_SCALE = 1.4826


@dataclass(kw_only=True)
class HeatConfig:
    """When a point counts as hot."""

    # Robust standard deviations above the ambient temperature, the median.
    deviations: float = quantity(5.0, above=0.0)
    # [K] At least this much above it.
    min_excess: float = quantity(15.0, unit="K", above=0.0)
    # A point must have this share of the largest excess within `blur`: a pixel or a voxel at the edge of something hot
    # is a mixture, and hot when half of it is.
    edge_share: float = quantity(0.5, low=0.0, high=1.0)
    # [m] Size of that mixture: a voxel of the map, or a thermal pixel at the distance it was measured.
    blur: float = quantity(0.2, unit="m", low=0.0)
    # Width of the change from cold to hot as a share of the threshold's excess.
    softness: float = quantity(0.1, above=0.0)
    # Probability from which on a point counts as hot.
    min_probability: float = quantity(0.5, above=0.0, high=1.0)
    # Hot things are small: two voxels count.
    regions: RegionConfig = field(default_factory=lambda: RegionConfig(min_area=0.01, min_points=2))


def ambient_temperature(temperature: np.ndarray) -> tuple[float, float]:
    """Median and robust standard deviation (1.4826 MAD) of what is known of temperatures [°C]; NaN without any."""
    known = temperature[np.isfinite(temperature)]
    if not len(known):
        return np.nan, np.nan
    middle = float(np.median(known))
    return middle, _MAD_SCALE * float(np.median(np.abs(known - middle)))


def heat_probability(p_MP: np.ndarray, temperature: np.ndarray, config: HeatConfig | None = None) -> np.ndarray:
    """Probability that each point belongs to something hot: a logistic function of its excess over the ambient.

    The threshold is the largest of `min_excess`, `deviations` robust standard deviations, and `edge_share` of the
    largest excess nearby. The median is the ambient as long as less than half of what was seen is hot.

    Args:
        p_MP: (N, 3) [m].
        temperature: (N,) [°C], NaN where never seen.

    Returns:
        (N,), NaN where the temperature or the point is not known.
    """
    config = config or HeatConfig()
    p_MP, temperature = np.asarray(p_MP, float).reshape(-1, 3), np.asarray(temperature, float).ravel()
    known = np.flatnonzero(np.isfinite(temperature) & np.isfinite(p_MP).all(axis=1))
    probability = np.full(len(p_MP), np.nan)
    if not len(known):
        return probability
    ambient, deviation = ambient_temperature(temperature)
    excess = temperature[known] - ambient
    threshold = np.full(len(known), max(config.min_excess, config.deviations * deviation))
    candidates = np.flatnonzero(excess > threshold)
    if len(candidates) and config.blur > 0:
        pairs = KDTree(p_MP[known[candidates]]).query_pairs(config.blur, output_type="ndarray")
        nearby = excess[candidates]
        for one, other in (pairs.T, pairs.T[::-1]):
            np.maximum.at(nearby, one, excess[candidates[other]])
        threshold[candidates] = np.maximum(threshold[candidates], config.edge_share * nearby)
    probability[known] = expit((excess / threshold - 1) / config.softness)
    return probability


def hot_regions(
    p_MP: np.ndarray, temperature: np.ndarray, probability: np.ndarray, config: HeatConfig | None = None
) -> tuple[HotSpot, ...]:
    """Points (N, 3) that are probably hot (N,), grouped in space, the hottest first."""
    config = config or HeatConfig()
    temperature = np.asarray(temperature, float).ravel()
    found = find_regions(
        p_MP, probability, config.regions, name="heat", threshold=config.min_probability, in_space=True
    )
    spots = [
        HotSpot(
            **vars(region),
            max_temperature=float(temperature[members].max()),
            mean_temperature=float(temperature[members].mean()),
        )
        for region, members in found
    ]
    return tuple(sorted(spots, key=lambda spot: -spot.max_temperature))


class HeatDetector(LeafSystem):
    """
    .. pydrake_system::

        name: HeatDetector
        input_ports:
        - map_M
        output_ports:
        - heat_probability
        - hot_spots

    Finds hot things in the map (S0-b). It has no state: both outputs are computed when they are asked for.

    - `map_M` (`open3d.t.geometry.PointCloud`): points in M with the attribute `temperature` [°C], NaN where never seen.
    - `heat_probability` (array (N,)): for the points of `map_M`, see `heat_probability`.
    - `hot_spots` (tuple of `HotSpot`): groups of hot points, the hottest first.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PortError: the input is not connected or of another type.
    """

    def __init__(self, config: HeatConfig | None = None):
        super().__init__()
        self._config = config or HeatConfig()
        check_config(self._config, where="heat")
        self.DeclareAbstractInputPort("map_M", AbstractValue.Make(object()))
        needs = {self.input_port_ticket(self.GetInputPort("map_M").get_index())}
        self.DeclareAbstractOutputPort(
            "heat_probability", lambda: AbstractValue.Make(np.zeros(0)), weak_method(self._CalcProbability), needs
        )
        self.DeclareAbstractOutputPort(
            "hot_spots", lambda: AbstractValue.Make(()), weak_method(self._CalcHotSpots), needs
        )

    def _CalcProbability(self, context: Context, output: AbstractValue) -> None:
        map_M = eval_typed(self, context, "map_M", PointCloud)
        output.set_value(heat_probability(cloud_points(map_M), cloud_attribute(map_M, "temperature"), self._config))

    def _CalcHotSpots(self, context: Context, output: AbstractValue) -> None:
        map_M = eval_typed(self, context, "map_M", PointCloud)
        probability: Any = self.GetOutputPort("heat_probability").Eval(context)
        temperature = cloud_attribute(map_M, "temperature")
        output.set_value(hot_regions(cloud_points(map_M), temperature, probability, self._config))
