"""Which LiDAR shots at the floor came back: water sends nothing back, or what it mirrors."""

from dataclasses import dataclass, replace

import numpy as np

from ..errors import PortError
from ..sensing.lidar import sweep_rays
from ..sensing.scan import Scan
from ..sensing.scan_pattern import ScanPattern
from .shot_grid import BLOCKED, HIT, MIRROR, MISSING, ShotConfig, Shots, shot_evidence

_NO_SHOTS = Shots(np.zeros((0, 2)), np.zeros(0, np.uint8), np.zeros(0), np.zeros(0))
# [m] Layers in which a level of the floor is looked for, three together.
_LAYER = 0.02
# A layer is strong when it holds this share of the points of the fullest one.
_STRONG = 0.3
# [rad] Points on steeper surfaces are no floor.
_LEVEL = 0.35
# [m] How far the floor of a map may bend, the cells in which it is looked for, and [points] how many a cell needs.
_DRIFT, _CELL, _ENOUGH = 0.2, 1.5, 15


@dataclass(frozen=True, eq=False)
class RayMemory:
    """When every ray last came back: one that does not, wherever the robot goes, is hidden by the robot itself.

    Attributes:
        travelled: length of the way so far [m].
        returned_at: `travelled` at the last return of every ray, (N,) float32, -inf for never.
    """

    travelled: float
    returned_at: np.ndarray

    def after(self, distance: np.ndarray, step: float) -> "RayMemory":
        """This after a scan with these distances (N,), NaN where nothing came back, `step` [m] after the one before."""
        travelled = self.travelled + step
        return RayMemory(travelled, np.where(np.isfinite(distance), np.float32(travelled), self.returned_at))

    def hidden(self, config: ShotConfig) -> np.ndarray:
        """Rays that have not come back within the last `memory` of travel, or never yet, (N,) bool.

        Black things and water are passed within that distance; while the robot stands in front of one, nothing
        changes. What is hidden by a flipper counts wrongly until the robot has gone that far.
        """
        return self.travelled - self.returned_at > config.memory


def ray_distances(scan: Scan, pattern: ScanPattern) -> np.ndarray | None:
    """Distance of every ray of `pattern`, (N,) float32 [m], NaN where nothing came back; None without ring and column.

    Raises:
        PortError: a point's ring or column is not in the pattern.
    """
    ring, column = scan.attribute("ring"), scan.attribute("column")
    if ring is None or column is None:
        return None
    ring, column = ring.astype(int), column.astype(int)
    if len(ring) and (ring.max() >= pattern.rings or column.max() >= pattern.columns):
        raise PortError(
            "ring or column is not in the scan pattern",
            where="scan_S",
            value=(int(ring.max()), int(column.max())),
            valid=f"{pattern.rings} rings, {pattern.columns} columns",
        )
    distance = np.full(pattern.rays, np.nan, np.float32)
    x, y, z = scan.p_SP.T
    distance[ring * pattern.columns + column] = np.sqrt(
        x**2 + y**2 + (z - pattern.heights.astype(np.float32)[ring]) ** 2
    )
    return distance


def floor_height(
    p_MP: np.ndarray, tilt: np.ndarray | None = None, *, near: float = np.nan, search: float = 0.5
) -> float:
    """Height in M of the lowest strong horizontal level among points (N, 3) [m]; NaN where there is none.

    Strong is a layer of 0.06 m that holds at least 0.3 times as many points as the fullest one.

    Args:
        tilt: (N,) [rad]; points that are steeper than 0.35 rad are left out, those with NaN are not.
        near: when given, only levels within `search` of this height count: below the floor may be mirror images.
    """
    z = np.asarray(p_MP, float).reshape(-1, 3)[:, 2]
    level = np.isfinite(z)
    if tilt is not None:
        level &= ~(np.abs(tilt) > _LEVEL)
    if np.isfinite(near):
        level &= ~(np.abs(z - near) > search)
    return _lowest_level(z[level])


def local_floor_height(p_MP: np.ndarray, tilt: np.ndarray | None, z_floor: float) -> np.ndarray:
    """Height of the floor at each point (N, 3), (N,) [m]: a map bends a little where the path that made it drifted.

    In cells of 1.5 m it is the median of the level points within 0.2 m of `z_floor`, smoothed over the neighbouring
    cells; `z_floor` where there are too few.

    Args:
        tilt: (N,) [rad]; points that are steeper than 0.35 rad are left out, those with NaN, too.
    """
    floor = np.full(len(p_MP), float(z_floor))
    finite = np.isfinite(p_MP).all(axis=1)
    with np.errstate(invalid="ignore"):
        level = finite & (np.abs(p_MP[:, 2] - z_floor) < _DRIFT)
        if tilt is not None:
            level &= np.abs(tilt) < _LEVEL
    if not level.any() or not np.isfinite(z_floor):
        return floor
    low = p_MP[finite, :2].min(axis=0)
    cell = np.zeros((len(p_MP), 2), np.int64)
    cell[finite] = np.floor((p_MP[finite, :2] - low) / _CELL)
    shape = cell.max(axis=0) + 1
    if shape.prod() > 1e6:  # stray points kilometres away
        return floor
    flat = cell[:, 0] * shape[1] + cell[:, 1]
    heights = np.full(int(shape.prod()), np.nan)
    order = np.flatnonzero(level)[np.argsort(flat[level], kind="stable")]
    for members in np.split(order, np.flatnonzero(np.diff(flat[order])) + 1):
        if len(members) >= _ENOUGH:
            heights[flat[members[0]]] = np.median(p_MP[members, 2])
    padded = np.pad(heights.reshape(shape), 1, constant_values=np.nan)
    around = np.lib.stride_tricks.sliding_window_view(padded, (3, 3)).reshape(-1, 9)
    known = np.isfinite(around).any(axis=1)
    smooth = np.full(len(around), float(z_floor))
    smooth[known] = np.nanmedian(around[known], axis=1)
    floor[finite] = smooth[flat[finite]]
    return floor


def _lowest_level(z: np.ndarray) -> float:
    if not len(z):
        return np.nan
    if np.ptp(z) > 1e5 * _LAYER:  # stray points kilometres away
        z = z[np.abs(z - np.median(z)) < 2e4 * _LAYER]
    bins = np.floor(z / _LAYER).astype(np.int64)
    bins -= bins.min() - 1
    layer = np.convolve(np.bincount(bins, minlength=3), np.ones(3), "same")
    lowest = int(np.argmax(layer >= _STRONG * layer.max()))
    while lowest + 1 < len(layer) and layer[lowest + 1] > layer[lowest]:
        lowest += 1  # up to the peak of that level
    return float(np.median(z[np.abs(bins - lowest) <= 1]))


def shots_at_floor(
    pattern: ScanPattern,
    distance: np.ndarray,
    X_MS0: np.ndarray,
    X_MS1: np.ndarray,
    z_floor: float,
    config: ShotConfig,
    hidden: np.ndarray | None = None,
) -> Shots:
    """Sorts the shots of one scan by what became of them.

    A shot whose way meets the floor within `max_range` is a hit when it came back from about the floor's height, and
    blocked when it came back from above. Without a return it is missing, from clearly below the floor it is a mirror
    image, but both only in a gap of its ring that is at most `max_gap` wide and has hits on both sides: elsewhere
    something dark may stand on the floor, or the floor may end. The floor's height is taken anew from the scan, in a
    gap from the hits beside it, and hits count where they were measured: an error of the pose or of the height moves
    all shots alike.

    Args:
        distance: of every ray of the pattern, (N,) [m], NaN where nothing came back.
        X_MS0, X_MS1: poses of the sensor at the start and at the end of the scan, (4, 4).
        z_floor: about where the floor is [m].
        hidden: rays whose missing says nothing, (N,) bool.

    Returns:
        The shots; none when too little of the floor was found or a pose is not finite.
    """
    if not (np.isfinite(X_MS0).all() and np.isfinite(X_MS1).all() and np.isfinite(z_floor)):
        return _NO_SHOTS
    rings = _rings_at_floor(pattern, X_MS0, X_MS1, z_floor, config)
    if not len(rings):
        return _NO_SHOTS
    shape = (len(rings), pattern.columns)
    part = replace(pattern, elevations=pattern.elevations[rings], heights=pattern.heights[rings])
    p_MR, d_M = (array.reshape(*shape, 3) for array in sweep_rays(part, X_MS0, X_MS1))
    distance = distance.reshape(pattern.rings, -1)[rings]
    z_start, slope = p_MR[..., 2], d_M[..., 2]
    z_return = z_start + distance * slope
    near = z_return[np.abs(z_return - np.float32(z_floor)) <= config.floor_search]
    if len(near) < config.min_floor_points:
        return _NO_SHOTS
    floor = np.float32(_lowest_level(near))
    with np.errstate(divide="ignore"):
        way = np.where(slope < 0, (floor - z_start) / slope, np.float32(np.inf))
    meets = (way > 0) & (way <= config.max_range)
    tolerance = config.tolerance + config.tolerance_growth * np.minimum(way, np.float32(config.max_range))
    above = z_return - floor  # NaN for what did not come back: no comparison with it is true
    hit = meets & (np.abs(above) <= tolerance)
    blocked = meets & (above > tolerance)

    # Gaps lie between returns that do not come from below the floor.
    solid = np.isfinite(distance) & ~(meets & (above < -tolerance))
    gap = meets & ~solid
    if hidden is not None:
        gap &= ~hidden.reshape(pattern.rings, -1)[rings]
    ring, column, before, after = _narrow_gaps(gap, solid, hit, way, pattern.azimuths, config.max_gap)
    # The higher side: a mirror image of something low passes for a hit a little below the floor.
    z_gap = floor + np.maximum(above[ring, before], above[ring, after])
    way_gap = (z_gap - z_start[ring, column]) / slope[ring, column]

    # One after another: what hit, what lies in gaps, what was blocked.
    rows, columns = zip(np.nonzero(hit), (ring, column), np.nonzero(blocked), strict=True)
    index = np.concatenate(rows), np.concatenate(columns)
    length = np.concatenate([distance[hit], way_gap.astype(np.float32), way[blocked]])
    hits, told = len(rows[0]), len(rows[0]) + len(rows[1])
    mirror = np.isfinite(distance[ring, column])
    kind = np.full(len(length), BLOCKED, np.uint8)
    kind[:hits], kind[hits:told] = HIT, np.where(mirror, MIRROR, MISSING)
    xy_M = p_MR[index][:, :2] + length[:, None] * d_M[index][:, :2]
    height = -length[:told] * slope[index[0][:told], index[1][:told]]
    hit_says, missing_says, told_weight = shot_evidence(length[:told], height, pattern.detection_range, config)
    mirror_says = np.log(config.mirror_on_water / config.mirror_on_ground)
    evidence, weight = np.zeros((2, len(length)), np.float32)
    evidence[:hits], evidence[hits:told] = hit_says[:hits], np.where(mirror, mirror_says, missing_says[hits:])
    weight[:hits], weight[hits:told] = told_weight[:hits], np.where(mirror, 1.0, told_weight[hits:])
    return Shots(xy_M, kind, evidence, weight)


def _rings_at_floor(
    pattern: ScanPattern, X_MS0: np.ndarray, X_MS1: np.ndarray, z_floor: float, config: ShotConfig
) -> np.ndarray:
    """Index of the rings that can meet the floor within range: the others are left out before anything is computed."""
    lowest = min(X_MS0[2, 3], X_MS1[2, 3]) - z_floor - config.floor_search
    lean = np.arccos(np.clip(min(X_MS0[2, 2], X_MS1[2, 2]), -1, 1))
    return np.flatnonzero(pattern.elevations - lean <= -np.arcsin(np.clip(lowest / config.max_range, 0, 1)))


def _narrow_gaps(
    gap: np.ndarray, solid: np.ndarray, hit: np.ndarray, way: np.ndarray, azimuths: np.ndarray, max_gap: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Shots in gaps that are at most `max_gap` [m] wide and have a hit on either side.

    Args:
        gap, solid, hit: of every shot, (rings, columns) bool. way: to the floor [m].

    Returns:
        Ring and column of the shots, and columns of the hits before and after each, (n,) each.
    """
    ring, column = np.nonzero(gap)
    before, after = _solid_neighbours(solid, ring, column)
    bounded = (before >= 0) & (after < solid.shape[1])
    ring, column, before, after = (index[bounded] for index in (ring, column, before, after))
    angle = np.abs(azimuths[after] - azimuths[before])
    bounded = hit[ring, before] & hit[ring, after] & (angle * way[ring, column] <= max_gap)
    return ring[bounded], column[bounded], before[bounded], after[bounded]


def _solid_neighbours(solid: np.ndarray, ring: np.ndarray, column: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Column of the nearest solid shot of the ring before and after each shot; -1 or the number of columns for none."""
    columns = np.arange(solid.shape[1])
    before = np.maximum.accumulate(np.where(solid, columns, -1), axis=1)
    after = np.minimum.accumulate(np.where(solid, columns, len(columns))[:, ::-1], axis=1)[:, ::-1]
    return before[ring, column], after[ring, column]
