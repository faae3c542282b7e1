"""How likely a point of the map is water: near-infrared brightness, range, tilt and LiDAR evidence together."""

from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np
from open3d.t.geometry import PointCloud
from scipy.spatial import KDTree
from scipy.special import expit, logit

from ..config import quantity
from ..errors import InputError
from .brightness import dark_threshold
from .lidar_water import floor_height, local_floor_height
from .regions import Region, RegionConfig, find_regions, group_points
from .shot_grid import ShotConfig, ShotGrid

# In the order in which S0-c and then this project add them.
FILTERS = ("threshold", "range", "tilt", "lidar")
# Neighbours that stand in for a tilt that is not known: how many at most, and how near [m].
_NEIGHBOURS, _NEIGHBOUR_RANGE = 8, 0.25
# Log likelihood ratio from which on LiDAR shots speak for water; what is doubted has this share of `min_probability`.
_SPEAKS, _DOUBT = 1.0, 0.9
# What hides a part of a puddle from one of the two splits it: points of a patch may be so many times as far apart.
_PATCH = 2.0


@dataclass(kw_only=True)
class WaterConfig:
    """When a point counts as water. Log odds are natural logarithms."""

    # [s] Interval at which a new scan is looked for; that of the LiDAR or shorter, or scans are missed.
    period: float = quantity(0.1, unit="s", above=0.0)
    # Share of the seen points that are water before anything is known.
    prior: float = quantity(0.1, above=0.0, high=0.5)
    # Reflectance at 1450 nm below which a point is dark, half of that of a concrete floor; None chooses it from the
    # points of the floor that were measured within half of `trust_range`, see `dark_threshold`.
    threshold: float | None = quantity(0.16, low=0.0)
    # The chosen threshold is at most this: between two paints on a dry floor is a valley, too.
    threshold_limit: float = quantity(0.2, above=0.0)
    # Width of the change from dark to bright as a share of the threshold.
    softness: float = quantity(0.3, above=0.0)
    # Log odds that a dark and a bright point give and take. Much that is not water is dark, no water is bright.
    dark_evidence: float = quantity(3.0, low=0.0)
    bright_evidence: float = quantity(5.0, low=0.0)
    # [m] Distance at which a dark point tells half as much: dark may mean that too little of the lamp's light arrives.
    trust_range: float = quantity(8.0, unit="m", above=0.0)
    # [deg] A surface that is tilted less can be water; from twice this on it cannot.
    tilt_limit_deg: float = quantity(20.0, unit="deg", above=0.0, high=45.0)
    # [m] A point that is less above or below the floor can be water; from twice this on it cannot.
    height_limit: float = quantity(0.07, unit="m", above=0.0)
    # Log odds that a point which cannot be water loses.
    form_evidence: float = quantity(10.0, low=0.0)
    # What LiDAR evidence counts where near-infrared never looked. With half, it needs log odds of 4.4 by itself.
    lidar_alone: float = quantity(0.5, low=0.0, high=1.0)
    # Share of the points of a patch for which near-infrared must say dark, and for which LiDAR shots must say wet, or
    # none of it is called water: a shadow is dark, too, and where the path drifted shots are missing.
    agreement: float = quantity(0.15, low=0.0, high=1.0)
    # Probability from which on a point counts as water.
    min_probability: float = quantity(0.5, above=0.0, high=1.0)
    shots: ShotConfig = field(default_factory=ShotConfig)
    regions: RegionConfig = field(default_factory=RegionConfig)


def cloud_attribute(cloud: PointCloud, name: str) -> np.ndarray:
    """Attribute `name` of a cloud as (N,) float, NaN throughout where the cloud does not have it."""
    if name in cloud.point:
        return cloud.point[name].numpy().reshape(-1).astype(float)
    return np.full(len(cloud_points(cloud)), np.nan)


def cloud_points(cloud: PointCloud) -> np.ndarray:
    """Points of a cloud, (N, 3) float; a cloud without any tensor has none."""
    return cloud.point.positions.numpy().astype(float) if "positions" in cloud.point else np.zeros((0, 3))


def water_probability(
    p_MP: np.ndarray,
    *,
    nir: np.ndarray | None = None,
    nir_range: np.ndarray | None = None,
    tilt: np.ndarray | None = None,
    shots: ShotGrid | None = None,
    z_floor: float | np.ndarray | None = None,
    filters: Collection[str] = FILTERS,
    config: WaterConfig | None = None,
) -> np.ndarray:
    """Probability that each point is water, from the sum of the log odds of what is known of it.

    - prior: logit(`prior`).
    - threshold: with x = tanh((threshold − nir) / (softness · threshold)), `dark_evidence` · x for a dark point,
      `bright_evidence` · x for a bright one.
    - range: the dark evidence is multiplied by 1 / (1 + (nir_range / trust_range)⁴); unknown range: by 1. Bright stays
      bright from any distance.
    - tilt: minus `form_evidence` for a surface that is too steep or too far from the floor's height. Where the tilt is
      not known, the median of neighbours within 0.25 m stands in; without any, height alone decides.
    - lidar: the log likelihood ratio of `shots`, for points at the height of the floor.

    Every filter can be left out, to see what it contributes. All but `threshold` are needed for what is dark and not
    water: things far away, upright things, things that a LiDAR sees.

    Without near-infrared the LiDAR counts `lidar_alone` times, so that it declares water only where it is sure. A patch
    of probable water on which the two do not agree (`agreement`) is doubted as a whole, and so is what would be a
    puddle of its own beside it and is not dark: its points are held just below `min_probability`. Where neither has
    looked, the probability is NaN: not known.

    Args:
        p_MP: (N, 3) [m], in a frame whose z points up.
        nir: reflectance near 1450 nm, NaN where never seen. nir_range: distance at which it was measured [m].
        tilt: angle between the surface's normal and the vertical [rad]. All (N,), or None when there is none.
        shots: LiDAR evidence.
        z_floor: height of the floor, about the same everywhere, or for each point [m]; found by `floor_height` when
            not given.
        filters: names from `FILTERS`.

    Returns:
        (N,) float in [0, 1] or NaN.

    Raises:
        InputError: an unknown filter, or arrays that differ in length.
    """
    config = config or WaterConfig()
    if unknown := sorted(set(filters) - set(FILTERS)):
        raise InputError("unknown filter", key="filters", value=unknown[0], valid=FILTERS)
    p_MP = np.asarray(p_MP, float).reshape(-1, 3)
    nir, nir_range, tilt = (
        _column(name, values, len(p_MP)) for name, values in (("nir", nir), ("nir_range", nir_range), ("tilt", tilt))
    )
    tilt = np.minimum(np.abs(tilt), np.abs(np.pi - np.abs(tilt)))
    if z_floor is None or not np.isfinite(z_floor).any():
        z_floor = floor_height(p_MP, tilt)
    if np.ndim(z_floor) == 0:
        z_floor = local_floor_height(p_MP, tilt, float(z_floor))
    with np.errstate(invalid="ignore"):
        height = np.abs(p_MP[:, 2] - z_floor)
        at_floor = _fades(height, config.height_limit)
    seen = np.isfinite(nir) & ("threshold" in filters)
    odds = np.full(len(p_MP), float(logit(config.prior)))
    evidence = np.zeros(len(p_MP))
    if seen.any():
        sample = (at_floor > 0.5) & ~(tilt > np.radians(config.tilt_limit_deg)) & ~(nir_range > config.trust_range / 2)
        evidence = _brightness_evidence(nir, nir[sample], config)
        if "range" in filters:
            trust = 1 / (1 + (np.nan_to_num(nir_range, nan=0.0) / config.trust_range) ** 4)
            evidence = np.where(evidence > 0, evidence * trust, evidence)
        odds += np.where(seen, evidence, 0.0)
    if "tilt" in filters:
        level_enough = _fades(_filled(tilt, p_MP), np.radians(config.tilt_limit_deg))
        odds -= config.form_evidence * (1 - at_floor * np.nan_to_num(level_enough, nan=1.0))
    known = seen
    if "lidar" in filters and shots is not None:
        ratio = shots.log_likelihood_ratio(p_MP[:, :2]) * np.nan_to_num(at_floor)
        odds += np.where(seen, 1.0, config.lidar_alone) * ratio
        known = known | (ratio != 0)
    probability = np.where(known & np.isfinite(p_MP).all(axis=1), expit(odds), np.nan)
    if "lidar" in filters and shots is not None and seen.any():
        doubted = _without_agreement(p_MP, probability, seen & (evidence > 0), ratio > _SPEAKS, config)
        probability[doubted] = np.minimum(probability[doubted], _DOUBT * config.min_probability)
    return probability


def _without_agreement(
    p_MP: np.ndarray, probability: np.ndarray, dark: np.ndarray, wet: np.ndarray, config: WaterConfig
) -> np.ndarray:
    """Indices of points that are probably water, in patches where near-infrared or LiDAR does not speak for it.

    What would be a puddle of its own must be dark itself: missing shots beside a puddle are no part of it.
    """
    with np.errstate(invalid="ignore"):
        chosen = np.flatnonzero(probability >= config.min_probability)
    doubted = np.zeros(len(chosen), bool)
    for reach, needed in ((_PATCH * config.regions.reach, (dark, wet)), (config.regions.reach, (dark,))):
        group = group_points(p_MP[chosen, :2], config.regions.cell, reach)
        for says in needed:
            share = np.bincount(group, says[chosen]) / np.maximum(np.bincount(group), 1)
            doubted |= share[group] < config.agreement
    return chosen[doubted]


def find_puddles(p_MP: np.ndarray, probability: np.ndarray, config: WaterConfig | None = None) -> tuple[Region, ...]:
    """Points (N, 3) that are probably water (N,), grouped in plan into puddles, the largest first."""
    config = config or WaterConfig()
    found = find_regions(p_MP, probability, config.regions, name="water", threshold=config.min_probability)
    return tuple(region for region, _ in found)


def _brightness_evidence(nir: np.ndarray, floor_nir: np.ndarray, config: WaterConfig) -> np.ndarray:
    threshold = config.threshold
    if threshold is None:
        chosen = dark_threshold(floor_nir if np.isfinite(floor_nir).any() else nir).value
        threshold = min(chosen, config.threshold_limit) if np.isfinite(chosen) else config.threshold_limit
    dark = np.tanh((threshold - nir) / max(config.softness * threshold, 1e-9))
    return dark * np.where(dark > 0, config.dark_evidence, config.bright_evidence)


def _fades(value: np.ndarray, limit: float) -> np.ndarray:
    """1 up to `limit`, 0 from twice that on, in between linear; NaN stays NaN."""
    return np.clip(2 - value / limit, 0, 1)


def _filled(tilt: np.ndarray, p_MP: np.ndarray) -> np.ndarray:
    """Tilt, where not known the median of the nearest points that have one, NaN where there are none near."""
    usable = np.isfinite(p_MP).all(axis=1)
    known, wanted = np.flatnonzero(usable & np.isfinite(tilt)), np.flatnonzero(usable & ~np.isfinite(tilt))
    if not len(known) or not len(wanted):
        return tilt
    tree = KDTree(p_MP[known])
    _, nearest = tree.query(p_MP[wanted], k=min(_NEIGHBOURS, len(known)), distance_upper_bound=_NEIGHBOUR_RANGE)
    values = np.append(tilt[known], np.nan)[nearest.reshape(len(wanted), -1)]
    filled = tilt.copy()
    some = np.isfinite(values).any(axis=1)
    filled[wanted[some]] = np.nanmedian(values[some], axis=1)
    return filled


def _column(name: str, values: np.ndarray | None, length: int) -> np.ndarray:
    if values is None:
        return np.full(length, np.nan)
    column = np.asarray(values, float).ravel()
    if len(column) != length:
        raise InputError("length differs from that of the points", key=name, value=len(column), valid=length)
    return column
