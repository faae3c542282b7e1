"""What changed between an earlier survey map and new keyframes: points first, then objects."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import KDTree

from ..clouds import estimate_normals
from ..config import quantity
from ..hazards.regions import group_points
from ..registration import IcpConfig, RegistrationConfig
from .seen_space import SeenSpace
from .sight import Rays, SeenSpaceConfig, look_again

UNCHANGED, APPEARED, VANISHED, FILLED_IN, NOT_SEEN_AGAIN = range(5)
CHANGES = ("unchanged", "appeared", "vanished", "filled in", "not seen again")


def _alignment() -> RegistrationConfig:
    return RegistrationConfig(
        method="point_to_plane",
        icp=IcpConfig(max_distances=[1.0, 0.5, 0.25], source_voxel=0.2, normal_radius=0.4),
        inlier_distance=0.15,
        max_correction=1.5,
        max_correction_deg=15.0,
        retry_fitness=0.0,
    )


@dataclass(kw_only=True)
class SurveyUpdateConfig:
    """When something counts as changed."""

    # [m] Edge length of a voxel of the updated map.
    voxel_size: float = quantity(0.1, unit="m", above=0)
    seen: SeenSpaceConfig = field(default_factory=SeenSpaceConfig)
    # Registration of the new map to the earlier one; the kernel cuts off what changed.
    alignment: RegistrationConfig = field(default_factory=_alignment)
    # [-] Part of the upright surfaces which the new scans saw where the earlier survey had looked too, that must
    # be in the earlier map; less is taken for another building.
    min_agreement: float = quantity(0.6, unit="-", low=0, high=1)
    # [m] Points of both surveys this near are of the same surface: noise, pose errors and voxels together.
    tolerance: float = quantity(0.2, unit="m", above=0)
    # [m] Radius in which normals are estimated.
    normal_radius: float = quantity(0.3, unit="m", above=0)
    # [keyframes] Keyframes that must have seen free space where something appeared or vanished.
    min_views: int = quantity(2, unit="keyframes", low=1)
    # [-] Log-odds of a keyframe that hit a point of the earlier map and of one that saw through it.
    hit_log_odds: float = quantity(1.0, unit="-", above=0)
    through_log_odds: float = quantity(0.7, unit="-", above=0)
    # [-] Log-odds against a point that has vanished.
    vanished_log_odds: float = quantity(1.3, unit="-", above=0)
    # [m] Changed points this near to each other are of one object.
    grouping_distance: float = quantity(0.3, unit="m", above=0)
    # [points] Smallest object, and how many of its points must have free space all around.
    min_points: int = quantity(8, unit="points", low=1)
    min_core_points: int = quantity(4, unit="points", low=1)
    # [m] An object is no shell along a surface: a tenth of its points is farther than this from everything that the
    # other survey mapped.
    min_thickness: float = quantity(0.25, unit="m", low=0)
    # [m] Longest side of the box around an object, at least.
    min_extent: float = quantity(0.2, unit="m", low=0)
    # [m] Height of that box, at least: a flat strip is floor that the other survey's rays passed over.
    min_height: float = quantity(0.1, unit="m", low=0)


@dataclass(frozen=True, eq=False)
class ChangedObject:
    """A group of changed points. Read-only.

    Attributes:
        kind: "appeared" or "vanished".
        centre, extent: of the box around it along the axes of M, (3,) [m].
        points: in M, (N, 3) float32 [m].
        confidence: mean probability that its points changed, from the number of keyframes that saw free space, [0, 1].
    """

    kind: str
    centre: np.ndarray
    extent: np.ndarray
    points: np.ndarray
    confidence: float

    def __deepcopy__(self, memo: dict) -> "ChangedObject":
        return self


@dataclass(frozen=True, eq=False)
class Changes:
    """Attributes: change of every point of the earlier (N,) and of the new map (K,), uint8, and the objects."""

    earlier: np.ndarray
    new: np.ndarray
    objects: tuple[ChangedObject, ...]


def map_normals(p_MP: np.ndarray, radius: float) -> np.ndarray:
    """Unit normals (N, 3) as `estimate_normals`, also for a map of less than three points, which has none."""
    return estimate_normals(p_MP, radius) if len(p_MP) > 2 else np.zeros((len(p_MP), 3))


def free_around(p_MP: np.ndarray, seen: SeenSpace, depth: float) -> np.ndarray:
    """Keyframes that saw free space `depth` [m] from each point on all six sides along the axes of M, the fewest, (N,).

    A ray along a floor frees voxels that hold floor, but none under it; so this is zero for every floor and wall. It
    does without normals, which can be wrong on the line that a ring of a LiDAR leaves.
    """
    views = np.full(len(p_MP), np.iinfo(np.uint16).max, np.uint16)
    for side in depth * np.vstack([np.eye(3), -np.eye(3)]):
        views = np.minimum(views, seen.views_at(p_MP + side))
    return views


def find_changes(
    p_earlier: np.ndarray,
    p_new: np.ndarray,
    seen_earlier: SeenSpace,
    seen_new: SeenSpace,
    rays: list[Rays],
    config: SurveyUpdateConfig,
) -> Changes:
    """Compares two maps in M.

    A new point has *appeared* when the earlier map has nothing within `tolerance` and the earlier survey saw its space
    free. An earlier point has *vanished* when the new map has nothing within half the tolerance and the new rays went
    through it: Σ through − Σ hit of their log-odds, see `look_again`. An object begins only at points with free space
    seen all around them; the others within `grouping_distance` of these join it. What makes no object
    is not reported: such a new point is *filled in* and such an earlier point *not seen again*.

    Args:
        p_earlier, p_new: points of the maps (N, 3), (K, 3) [m], at least one each.
        seen_earlier, seen_new: the space that each survey saw free.
        rays: the new ones.
    """
    depth = config.seen.margin
    from_earlier, from_new = KDTree(p_earlier).query(p_new)[0], KDTree(p_new).query(p_earlier)[0]

    views = seen_earlier.views_at(p_new)
    candidate = (from_earlier > config.tolerance) & (views >= config.min_views)
    index = np.flatnonzero(candidate)
    core = free_around(p_new[index], seen_earlier, depth) > 0
    group = changed_groups(p_new[index], core, from_earlier[index], config)
    new = np.where(from_earlier <= config.tolerance, UNCHANGED, FILLED_IN).astype(np.uint8)
    new[index[group >= 0]] = APPEARED
    objects = _objects("appeared", p_new[index], group, config.through_log_odds * views[index])

    index = np.flatnonzero(from_new > config.tolerance / 2)
    normals = map_normals(p_earlier, config.normal_radius)[index]
    sight = look_again(p_earlier[index], normals, rays, config.seen)
    against = config.through_log_odds * sight.through - config.hit_log_odds * sight.hit
    candidate = (sight.through >= config.min_views) & (against >= config.vanished_log_odds)
    confirmed = from_new <= config.tolerance
    confirmed[index[sight.hit > 0]] = True
    index, against = index[candidate], against[candidate]
    core = free_around(p_earlier[index], seen_new, depth) > 0
    group = changed_groups(p_earlier[index], core, from_new[index], config)
    earlier = np.where(confirmed, UNCHANGED, NOT_SEEN_AGAIN).astype(np.uint8)
    earlier[index[group >= 0]] = VANISHED
    objects += _objects("vanished", p_earlier[index], group, against)
    return Changes(earlier, new, tuple(objects))


def changed_groups(p_MP: np.ndarray, core: np.ndarray, away: np.ndarray, config: SurveyUpdateConfig) -> np.ndarray:
    """Number of the object of every changed point, (N,) int, -1 where it makes none.

    Args:
        core: whether an object can begin at the point, (N,) bool.
        away: distance to the nearest point of the other survey (N,) [m].
    """
    group = np.full(len(p_MP), -1)
    if not core.any():
        return group
    label = group_points(p_MP[core], config.voxel_size, config.grouping_distance)
    distance, nearest = KDTree(p_MP[core]).query(p_MP)
    joined = np.where(distance <= config.grouping_distance, label[nearest], -1)
    kept = 0
    for i in range(label.max() + 1):
        members = np.flatnonzero(joined == i)
        if len(members) < config.min_points or core[members].sum() < config.min_core_points:
            continue
        thick = np.quantile(away[members], 0.9) >= config.min_thickness
        extent = np.ptp(p_MP[members], axis=0)
        if thick and extent.max() >= config.min_extent and extent[2] >= config.min_height:
            group[members] = kept
            kept += 1
    return group


def _objects(kind: str, p_MP: np.ndarray, group: np.ndarray, log_odds: np.ndarray) -> list[ChangedObject]:
    found = []
    for i in range(group.max(initial=-1) + 1):
        points = p_MP[group == i].astype(np.float32)
        low, high = points.min(axis=0).astype(float), points.max(axis=0).astype(float)
        confidence = float((1 / (1 + np.exp(-log_odds[group == i]))).mean())
        found.append(ChangedObject(kind, (low + high) / 2, high - low, points, confidence))
    return found
