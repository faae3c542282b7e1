"""The semantic map: every point of the survey map with its class, its dose rate and how sure that is."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import open3d as o3d
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem
from scipy.spatial import KDTree

from ..clouds import transform_points
from ..config import check_config, quantity
from ..dose.dose_field import DoseField
from ..ports import eval_typed, weak_method
from ..slam import Keyframe
from .classes import HEAT, OTHER, SOURCE, WATER
from .water import cloud_points


@dataclass(kw_only=True)
class SemanticMapConfig:
    """When a point belongs to a class, and what is a mirror image."""

    # Probability from which on a point is called water or heat.
    min_probability: float = quantity(0.5, above=0.0, high=1.0)
    # Distance from a source's estimated place within which points are called source.
    source_radius: float = quantity(0.3, unit="m", low=0.0)
    # A point this far below the floor, seen through water, is a mirror image of something above.
    mirror_depth: float = quantity(0.15, unit="m", above=0.0)
    # Distance from a point of water within which a line of sight goes through that water.
    mirror_gap: float = quantity(0.15, unit="m", above=0.0)
    # Edge length of the survey map's voxels.
    voxel_size: float = quantity(0.1, unit="m", above=0.0)


def label_points(
    water_probability: np.ndarray, heat_probability: np.ndarray, near_source: np.ndarray, min_probability: float
) -> np.ndarray:
    """Class ids (N,) uint8 of points: heat before water before source, since one can be all of it; NaN is no class."""
    labels = np.full(len(water_probability), OTHER.id, np.uint8)
    labels[near_source] = SOURCE.id
    with np.errstate(invalid="ignore"):
        labels[water_probability >= min_probability] = WATER.id
        labels[heat_probability >= min_probability] = HEAT.id
    return labels


def mirror_images(
    keyframes: Sequence[Keyframe], p_BS: np.ndarray, water_M: np.ndarray, config: SemanticMapConfig
) -> np.ndarray:
    """Points of keyframes that are mirror images in water: below it, and seen through it.

    A pit looks the same to a LiDAR as a mirror, so a point below the floor stays unless the line from the sensor to it
    crosses the surface of a puddle that is known for other reasons.

    Args:
        p_BS: position of the LiDAR in B (3) [m].
        water_M: points of water (K, 3) [m].

    Returns:
        (N, 3) points in M [m].
    """
    if not len(water_M):
        return np.zeros((0, 3))
    surface = float(np.median(water_M[:, 2]))
    tree = KDTree(water_M[:, :2])
    found = []
    for keyframe in keyframes:
        p_MS = keyframe.X_MB @ p_BS
        if p_MS[2] <= surface:
            continue
        # Few points lie so low: only these are looked at in full.
        X_MB, p_BP = keyframe.X_MB.GetAsMatrix34(), keyframe.p_BP
        low = p_BP @ X_MB[2, :3].astype(np.float32) < surface - config.mirror_depth - X_MB[2, 3]
        if not low.any():
            continue
        p_MP = transform_points(keyframe.X_MB.GetAsMatrix4(), p_BP[low].astype(float))
        share = (p_MS[2] - surface) / (p_MS[2] - p_MP[:, 2])
        crossing = p_MS[:2] + share[:, None] * (p_MP[:, :2] - p_MS[:2])
        found.append(p_MP[tree.query(crossing)[0] <= config.mirror_gap])
    return np.vstack(found) if found else np.zeros((0, 3))


class SemanticMap(LeafSystem):
    """
    .. pydrake_system::

        name: SemanticMap
        input_ports:
        - map_M
        - keyframes
        - water_probability
        - heat_probability
        - dose_field
        output_ports:
        - semantic_M

    Puts together what the detectors found (S0-f). It has no state: the output is computed when it is asked for.

    - `map_M` (`open3d.t.geometry.PointCloud`), `keyframes` (tuple of `Keyframe`): as from `SurveyMap`.
    - `water_probability`, `heat_probability` (arrays (N,)): for the points of `map_M`, NaN where not known.
    - `dose_field` (`DoseField`): dose rate anywhere, and sources.
    - `semantic_M` (`open3d.t.geometry.PointCloud`): the points of `map_M` with all of its attributes and with `label`
      (uint8, see `CLASSES`), `water_probability`, `dose_rate` and `dose_rate_sigma` [uSv/h] (NaN as long as there is
      no estimate). Mirror images in water are left out, see `mirror_images`.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PortError: an input is not connected or of another type.
    """

    def __init__(self, config: SemanticMapConfig | None = None, *, X_BS: RigidTransform | None = None):
        """
        Args:
            X_BS: pose of the LiDAR in the base; identity when not given.
        """
        super().__init__()
        self._config = config or SemanticMapConfig()
        check_config(self._config, where="semantic_map")
        self._p_BS = np.zeros(3) if X_BS is None else X_BS.translation()
        for name in ("map_M", "keyframes", "water_probability", "heat_probability", "dose_field"):
            self.DeclareAbstractInputPort(name, AbstractValue.Make(object()))
        self.DeclareAbstractOutputPort(
            "semantic_M",
            lambda: AbstractValue.Make(PointCloud()),
            weak_method(self._CalcMap),
            {self.all_input_ports_ticket()},
        )

    def _CalcMap(self, context: Context, output: AbstractValue) -> None:
        config = self._config
        map_M = eval_typed(self, context, "map_M", PointCloud)
        keyframes = eval_typed(self, context, "keyframes", tuple)
        water = eval_typed(self, context, "water_probability", np.ndarray)
        heat = eval_typed(self, context, "heat_probability", np.ndarray)
        dose = eval_typed(self, context, "dose_field", DoseField)
        points = cloud_points(map_M)
        with np.errstate(invalid="ignore"):
            wet = points[water >= config.min_probability]
        kept = ~_in_voxels_of(points, mirror_images(keyframes, self._p_BS, wet, config), config.voxel_size)
        points, water, heat = points[kept], water[kept], heat[kept]
        near_source = np.zeros(len(points), bool)
        for source in dose.sources:
            near_source |= np.linalg.norm(points - source.p_M, axis=1) < config.source_radius
        cloud = map_M.select_by_mask(o3d.core.Tensor(kept)) if len(kept) else map_M.clone()
        rate, sigma = dose.rate_and_sigma(points)
        attributes = {
            "label": label_points(water, heat, near_source, config.min_probability),
            "water_probability": water.astype(np.float32),
            "dose_rate": rate.astype(np.float32),
            "dose_rate_sigma": sigma.astype(np.float32),
        }
        for name, values in attributes.items():
            cloud.point[name] = o3d.core.Tensor(np.ascontiguousarray(values[:, None]))
        output.set_value(cloud)


def _in_voxels_of(points: np.ndarray, others: np.ndarray, voxel: float) -> np.ndarray:
    """Which points (N, 3) share a voxel with one of the others (K, 3), (N,) bool."""

    def keys(p: np.ndarray) -> np.ndarray:
        cells = np.floor(p / voxel).astype(np.int64)
        return (cells[:, 0] << 42) ^ ((cells[:, 1] & 0x1FFFFF) << 21) ^ (cells[:, 2] & 0x1FFFFF)

    return np.isin(keys(points), keys(others))
