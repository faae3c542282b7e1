"""Rays of keyframes, and what they say about points that were there before."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform
from scipy.spatial import KDTree

from ..config import quantity
from ..slam.keyframe import Keyframe


@dataclass(kw_only=True)
class SeenSpaceConfig:
    """How rays carve free space, and how they judge a point."""

    # [m] Edge length of a voxel of free space. A ray through it passed its centre within 0.09 m.
    voxel_size: float = quantity(0.1, unit="m", above=0)
    # [m] A ray carves up to this distance before its hit, so that noise and pose errors leave surfaces whole.
    stop_short: float = quantity(0.15, unit="m", low=0)
    # [m] Beyond, rays neither carve nor judge: 0.3 deg are 0.1 m there.
    max_range: float = quantity(20.0, unit="m", above=0)
    # [m] A point is judged by rays that passed within this distance of it.
    point_size: float = quantity(0.12, unit="m", above=0)
    # [m] A ray must go on this far behind a point, square to its surface, to have gone through it.
    margin: float = quantity(0.2, unit="m", above=0)
    # [m] A return this near confirms a point.
    hit_distance: float = quantity(0.15, unit="m", above=0)


@dataclass(frozen=True, eq=False)
class Rays:
    """Rays of one keyframe in the map frame M.

    Attributes:
        p_MS: where they start, (3,) [m].
        p_MP: where they were returned, (N, 3) float32 [m].
        time: when [s].
    """

    p_MS: np.ndarray
    p_MP: np.ndarray
    time: float


def keyframe_rays(keyframe: Keyframe, p_BS: np.ndarray, X_MK: RigidTransform | None = None) -> Rays:
    """The rays of a keyframe.

    A cloud with `intensity` can hold points of another sensor, which started elsewhere: they have no intensity (NaN)
    and are left out, as are points that are not finite.

    Args:
        p_BS: the LiDAR in the base (3,) [m].
        X_MK: pose in M of the frame K that the keyframe calls its map; identity when not given.
    """
    points = keyframe.p_BP
    usable = np.isfinite(points).all(axis=1)
    if "intensity" in keyframe.cloud_B.point:
        usable &= np.isfinite(keyframe.cloud_B.point["intensity"].numpy()[:, 0])
    X_MB = (keyframe.X_MB if X_MK is None else X_MK @ keyframe.X_MB).GetAsMatrix4()
    p_MP = points[usable] @ X_MB[:3, :3].T.astype(np.float32) + X_MB[:3, 3].astype(np.float32)
    return Rays(X_MB[:3, :3] @ np.asarray(p_BS, float) + X_MB[:3, 3], p_MP, keyframe.time)


@dataclass(frozen=True, eq=False)
class Sight:
    """How many keyframes say what about each of N points; all zero where a point was out of view.

    Attributes:
        hit: (N,) uint16, returned a ray at the point.
        through: (N,) uint16, saw through it, and did not hit it.
        hidden: (N,) uint16, saw only something nearer in its direction.
    """

    hit: np.ndarray
    through: np.ndarray
    hidden: np.ndarray


def look_again(
    p_MP: np.ndarray, normals: np.ndarray, rays: Sequence[Rays], config: SeenSpaceConfig | None = None
) -> Sight:
    """Asks every keyframe about points of an earlier map.

    Each point is judged by the (up to four) rays of a keyframe that pass nearest and within `point_size`, themselves
    and not a grid of them: between two rings of a VLP-16, 2 deg apart, nothing is said. Where the surface is known,
    a ray went through it when it crossed its plane within `point_size` of the point and came from and ended `margin`
    or more off the plane. So a ray that grazes a floor or a wall does not see through it.

    Args:
        p_MP: points, (N, 3) [m].
        normals: unit normals of either sign, (N, 3); zero where unknown: then it is enough that a ray passed within
            `point_size` and ended `margin` or more behind.
    """
    config = config or SeenSpaceConfig()
    points, normals = np.asarray(p_MP, float), np.asarray(normals, float)
    counts = {name: np.zeros(len(points), np.uint16) for name in ("hit", "through", "hidden")}
    for bundle in rays:
        usable = np.isfinite(bundle.p_MP).all(axis=1)
        ends = bundle.p_MP[usable].astype(float) - bundle.p_MS
        length = np.linalg.norm(ends, axis=1)
        ends, length = ends[length > config.margin], length[length > config.margin]
        distance = np.linalg.norm(points - bundle.p_MS, axis=1)
        asked = np.flatnonzero((distance > config.margin) & (distance <= config.max_range))  # False for NaN
        if len(ends) == 0 or len(asked) == 0:
            continue
        to_point = points[asked] - bundle.p_MS
        hit, through, hidden = _judge(to_point, normals[asked], ends, length, config)
        counts["hit"][asked] += hit
        counts["through"][asked] += through & ~hit
        counts["hidden"][asked] += hidden & ~hit & ~through
    return Sight(**counts)


def _judge(
    p_SP: np.ndarray, normals: np.ndarray, ends: np.ndarray, length: np.ndarray, config: SeenSpaceConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(hit, through, hidden) of each point; everything is relative to the sensor, in axes of M."""
    distance = np.linalg.norm(p_SP, axis=1)
    directions = ends / length[:, None]
    widest = config.point_size / max(float(distance.min()), config.point_size)
    count = min(4, len(ends))
    chord, nearest = KDTree(directions).query(p_SP / distance[:, None], count, distance_upper_bound=widest)
    chord, nearest = chord.reshape(-1, count), nearest.reshape(-1, count)
    point, slot = np.nonzero(chord * distance[:, None] <= config.point_size)
    ray = nearest[point, slot]
    p, n, e = p_SP[point], normals[point], ends[ray]
    hits = np.linalg.norm(e - p, axis=1) <= config.hit_distance
    front, behind = -np.einsum("ij,ij->i", p, n), np.einsum("ij,ij->i", e - p, n)
    apart = (front * behind < 0) & (np.minimum(np.abs(front), np.abs(behind)) >= config.margin)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = e * (front / (front - behind))[:, None]
    crosses = apart & (np.linalg.norm(crossing - p, axis=1) <= config.point_size)
    beyond = length[ray] - distance[point]
    passes = np.where((n != 0).any(axis=1), crosses, beyond >= config.margin)
    stops = beyond <= -config.margin
    verdicts = []
    for flags in (hits, passes, stops):
        verdict = np.zeros(len(p_SP), bool)
        verdict[point[flags]] = True
        verdicts.append(verdict)
    return verdicts[0], verdicts[1], verdicts[2]
