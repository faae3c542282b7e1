"""How right a semantic map is, against the world that was surveyed; nothing in the loop may use this."""

from collections.abc import Sequence

import numpy as np
import open3d as o3d
from naraha.models.worlds import Solid, World
from naraha.systems.clouds import VoxelCloud, transform_points
from naraha.systems.dose import DoseField, DoseReadings
from naraha.systems.hazards.classes import HEAT, WATER
from naraha.systems.hazards.regions import Region
from naraha.systems.hazards.shot_grid import ShotGrid
from naraha.systems.hazards.water import (
    FILTERS,
    WaterConfig,
    cloud_attribute,
    cloud_points,
    find_puddles,
    water_probability,
)
from naraha.systems.sensing import RayScene
from naraha.systems.sensing.gamma_counter import source_dose_rate
from naraha.systems.slam import Keyframe
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform
from scipy.spatial import KDTree

# A measurement farther than this, and this share of its distance, from what its ray meets is no measurement of it [m].
NOISE = 0.1, 0.05
# Water counts where near-infrared saw it from nearer than this [m].
WATER_RANGE = 5.0


def intersection_over_union(found: np.ndarray, true: np.ndarray) -> float:
    """Of two masks (N,); 1 when both are empty."""
    union = np.count_nonzero(found | true)
    return float(np.count_nonzero(found & true) / union) if union else 1.0


def in_plan(solid: Solid, points: np.ndarray) -> np.ndarray:
    """Which points (N, 2) or (N, 3) are over or under an upright solid, (N,) bool."""
    p_MP = np.zeros((len(points), 3))
    p_MP[:, :2] = points[:, :2]
    p_G = transform_points(solid.X_WG().inverse().GetAsMatrix4(), p_MP)
    if solid.cylinder:
        return np.hypot(p_G[:, 0], p_G[:, 1]) <= solid.cylinder[0]
    return (np.abs(p_G[:, 0]) <= solid.box[0] / 2) & (np.abs(p_G[:, 1]) <= solid.box[1] / 2)


def solids_labelled(world: World, label: str) -> list[Solid]:
    return [solid for solid in world.solids if world.surfaces[solid.surface].label == label]


def match_puddles(puddles: Sequence[Region], pools: Sequence[Solid]) -> tuple[int, int]:
    """How many pools hold the centre of a puddle, and how many puddles have their centre in no pool."""
    centres = np.array([puddle.p_MC for puddle in puddles]).reshape(-1, 3)
    inside = np.array([in_plan(pool, centres) for pool in pools]).reshape(len(pools), len(puddles))
    return int(inside.any(axis=1).sum()), int((~inside.any(axis=0)).sum())


def true_classes(
    points: np.ndarray,
    keyframes: Sequence[Keyframe],
    true_poses: Sequence[RigidTransform],
    scene: RayScene,
    *,
    p_BS: np.ndarray,
    p_BD: np.ndarray,
    voxel: float,
) -> dict[str, np.ndarray]:
    """Whether most measurements in each map point were made of water, of something hot, (N,) bool by name.

    What a measurement was made of is told by its ray, from where the sensor truly was. So errors of the path, which
    move the map, and of the distance do not count as errors of the class. A measurement far from what its ray meets,
    such as a mirror image, was made of neither.

    Args:
        points: of the map (N, 3) [m].
        true_poses: X_WB of every keyframe.
        p_BS, p_BD: LiDAR and depth camera in the base (3) [m]; points of the latter have no intensity.
        voxel: edge length of the map's voxels [m].
    """
    names = (WATER.name, HEAT.name)
    voxels = VoxelCloud(voxel)
    for keyframe, X_WB in zip(keyframes, true_poses, strict=True):
        by_camera = ~np.isfinite(cloud_attribute(keyframe.cloud_B, "intensity"))
        start = np.where(by_camera[:, None], p_BD, p_BS)
        way = keyframe.p_BP - start
        distance = np.linalg.norm(way, axis=1)
        d_W = (way / distance[:, None]) @ X_WB.rotation().matrix().T
        hits = scene.cast(transform_points(X_WB.GetAsMatrix4(), start), d_W)
        near = np.abs(hits.distance - distance) < NOISE[0] + NOISE[1] * distance
        label = np.array([*scene.surface.labels, ""])[hits.lookup("label_id")]
        cloud = PointCloud(keyframe.cloud_B.point.positions)
        for name in names:
            cloud.point[name] = o3d.core.Tensor((near & (label == name)).astype(np.float32)[:, None])
        if "count" in keyframe.cloud_B.point:
            cloud.point["count"] = keyframe.cloud_B.point["count"]
        voxels = voxels.insert(cloud, keyframe.X_MB.GetAsMatrix4())
    measured = voxels.to_cloud()
    nearest = KDTree(measured.point.positions.numpy()).query(points)[1]
    return {name: measured.point[name].numpy()[nearest, 0] > 0.5 for name in names}


def water_metrics(
    world: World, cloud: PointCloud, true: np.ndarray, shots: ShotGrid, config: WaterConfig
) -> dict[str, float]:
    """Per-point IoU and puddles, with one filter after the other added (S0-c).

    Counted are the points that near-infrared saw from within `WATER_RANGE`.

    Args:
        true: which points of the map `cloud` are water, (N,) bool.
    """
    points, pools = cloud_points(cloud), solids_labelled(world, WATER.name)
    attributes = {name: cloud_attribute(cloud, name) for name in ("nir", "nir_range", "tilt")}
    with np.errstate(invalid="ignore"):
        counted = np.isfinite(attributes["nir"]) & (attributes["nir_range"] <= WATER_RANGE)
    metrics: dict[str, float] = {"pools": len(pools), "water_points": int((true & counted).sum())}
    for i, name in enumerate(FILTERS):
        filters = FILTERS[: i + 1]
        probability = water_probability(points, **attributes, shots=shots, filters=filters, config=config)
        with np.errstate(invalid="ignore"):
            wet = probability >= config.min_probability
        suffix = "" if filters == FILTERS else f"_with_{name}"
        metrics[f"water_iou{suffix}"] = intersection_over_union(wet[counted], true[counted])
        found, false = match_puddles(find_puddles(points, probability, config), pools)
        metrics[f"puddles_found{suffix}"], metrics[f"puddles_false{suffix}"] = found, false
    return metrics


def dose_metrics(scene: RayScene, field: DoseField, readings: DoseReadings, background: float) -> dict[str, float]:
    """Distance of the strongest source from where it is, and the mean relative error of the dose rate where measured.

    That is at the places of the readings, one a cube of 0.5 m, so that places where the robot stood long count once.
    """
    measured = readings.p_MG[readings.usable()]
    places = measured[np.unique(np.floor(measured / 0.5), axis=0, return_index=True)[1]]
    true = np.full(len(places), background)
    for source in scene.sources:
        p_WQ = np.array(source.p_FQ)
        distance = np.linalg.norm(places - p_WQ, axis=1)
        depth = scene.attenuation_along(places, p_WQ)
        true += source_dose_rate(np.array(source.activity), distance, depth)
    metrics: dict[str, float] = {"sources": len(scene.sources), "sources_found": len(field.sources)}
    if field.sources and scene.sources:
        offset = np.array([source.p_FQ for source in scene.sources]) - field.sources[0].p_M
        metrics["source_error_m"] = float(np.linalg.norm(offset, axis=1).min())
        metrics["source_error_horizontal_m"] = float(np.linalg.norm(offset[:, :2], axis=1).min())
    if len(places):
        metrics["dose_map_error"] = float((np.abs(field.rate(places) - true) / true).mean())
    return metrics
