"""Which points an eye sees and which are hidden from it: parallax of a camera, shadows of a lamp."""

from dataclasses import dataclass

import numpy as np

from ..config import quantity
from .projection import move_rows

# [rad] Edge of the cells in which the spacing of the points is counted.
_COARSE = np.float32(np.deg2rad(3.0))
# Points hide their own cell and this many around it.
_SPREAD = 2
# A z-buffer has at most this many cells; a finer one would cost more than it tells.
_MAX_CELLS = 300_000
_EMPTY = np.iinfo(np.int64).max
# A cell's key is the distance in steps of 1/8192 m, then the index of the point.
_STEPS, _INDEX_BITS = 8192, 24
# How deep a surface may be in a cell, in widths of the cell, when no normal tells: 76 degrees of incidence.
_STEEPEST = 4.0
# [rad] Error of a normal.
_TILT = 0.03


@dataclass(kw_only=True)
class VisibilityConfig:
    """When a point hides another one."""

    # [m], [1/m] What is this much behind a point, plus this times its distance squared, is behind it. Five standard
    # deviations of the difference of two depths of a D415, 0.003 z² each. Seen from two eyes b apart, what is nearer
    # together than this shifts by b times this [rad] at any distance: 0.2 degrees for 0.2 m.
    absolute: float = quantity(0.03, unit="m", above=0)
    quadratic: float = quantity(0.02, unit="1/m", low=0)
    # [-] A point hides what is within this many spacings of it. A pixel's diagonal, and half a pixel for the edge that
    # lies somewhere between the last point and the next, are 1.2.
    reach: float = quantity(1.2, unit="spacings", above=0)
    # [m] Points nearer than this to the eye hide nothing: they are the robot itself.
    nearest: float = quantity(0.1, unit="m", low=0)


def visible(
    p_BP: np.ndarray,
    p_BE: np.ndarray,
    *,
    normals: np.ndarray | None = None,
    occluders: np.ndarray | None = None,
    occluder_normals: np.ndarray | None = None,
    config: VisibilityConfig | None = None,
) -> np.ndarray:
    """Which points an eye sees: a camera, or a lamp, whose shadows are what it does not see.

    A z-buffer of the cloud itself, in the angles about the eye, holds the nearest point of every cell. Points fill the
    cells within `reach` spacings around them; how far apart they are is counted in each direction and at each
    distance, because a depth image, a LiDAR and voxels have very different spacings, so that surfaces have no holes.

    A point p is hidden by the point q of its cell when p is behind q by more than the tolerance and, where their
    normals are known, also behind the plane of q and q before the plane of p. A surface that is seen at a grazing angle
    fills a cell from near to far, but no point of it is behind the plane of another; nor is one of a convex edge or of
    a corner. Where neither normal is known, steps that a surface at 76 degrees of incidence makes hide nothing.

    What hides a point must be in the cloud: a face that no sensor has seen hides nothing.

    Args:
        p_BP: points in any frame B, (N, 3) [m].
        p_BE: where the eye is, (3) [m].
        normals: unit normals of the points in B, (N, 3), zero where unknown, of either sign.
        occluders, occluder_normals: the points that can hide others, (Q, 3) and (Q, 3); the points themselves when not
            given. They may be more or less than these.

    Returns:
        (N,) bool; False for points that are not finite.
    """
    config = config or VisibilityConfig()
    points, eye = np.asarray(p_BP, np.float32).reshape(-1, 3), np.asarray(p_BE, np.float32)
    if occluders is None:
        occluders, occluder_normals = points, normals
    seen = np.isfinite(points[:, 0] + points[:, 1] + points[:, 2])
    index = np.flatnonzero(seen)
    if len(index) == 0 or len(occluders) == 0:
        return seen
    R_FB = _facing(points[index[:: 1 + len(index) // 1000]] - eye)
    target = _Directions.of(move_rows(points[index], R_FB, -R_FB @ eye))
    bounds = [(float(part.min()), float(part.max())) for part in (target.a, target.b)]
    p_FQ = move_rows(np.asarray(occluders, np.float32).reshape(-1, 3), R_FB, -R_FB @ eye)
    chosen = np.flatnonzero(_within(p_FQ, bounds, float(_COARSE)))
    source = _Directions.of(p_FQ[:, chosen])
    near = (source.distance >= config.nearest) & (source.distance < target.distance.max())
    chosen, source = chosen[near], source.subset(near)
    if len(chosen) == 0:
        return seen

    reach = np.float32(config.reach) * _spacing(source)
    area = (bounds[0][1] - bounds[0][0]) * (bounds[1][1] - bounds[1][0])
    # Levels of cells are octaves apart, one of them as most points need it; the others reach 0.9 to 1.7 times as far
    # as they must, which leaves no holes.
    usual = max(float(np.median(reach)) / _SPREAD, float(np.sqrt(area / _MAX_CELLS)), 1e-5)
    octave = np.maximum(np.ceil(np.log2(reach / (_SPREAD * usual)) - np.float32(0.2)), -1).astype(int)
    tolerance = np.float32(config.absolute) + np.float32(config.quadratic) * np.square(target.distance)
    for k in range(octave.min(), octave.max() + 1):
        cell = usual * 2.0**k
        members = np.flatnonzero(octave == k)
        found = _look_up(source.subset(members), chosen[members], target, bounds, cell)
        distance = (found >> _INDEX_BITS).astype(np.float32) / np.float32(_STEPS)
        nearer = np.flatnonzero(distance < target.distance - tolerance)
        nearer = nearer[seen[index[nearer]]]
        p, q = index[nearer], found[nearer] & ((1 << _INDEX_BITS) - 1)
        n_P, n_Q = _normals(normals, p), _normals(occluder_normals, q)
        v_EP, v_EQ, noise = points[p] - eye, occluders[q] - eye, tolerance[nearer] - np.float32(config.absolute)
        limit = np.float32(config.absolute) + np.float32(_TILT) * np.linalg.norm(v_EP - v_EQ, axis=1)
        hidden = _depth_behind(v_EP, v_EQ, n_Q, noise) > limit
        hidden &= (_depth_behind(v_EQ, v_EP, n_P, -noise) < -limit) | ~_known(n_P)
        slack = tolerance[nearer] + np.float32(_STEEPEST * (_SPREAD + 1) * cell) * target.distance[nearer]
        hidden &= _known(n_P) | _known(n_Q) | (distance[nearer] < target.distance[nearer] - slack)
        seen[p[hidden]] = False
    return seen


def _normals(normals: np.ndarray | None, index: np.ndarray) -> np.ndarray:
    return np.zeros((len(index), 3), np.float32) if normals is None else np.asarray(normals[index], np.float32)


def _known(normals: np.ndarray) -> np.ndarray:
    return (normals[:, 0] != 0) | (normals[:, 1] != 0) | (normals[:, 2] != 0)


def _depth_behind(v_EP: np.ndarray, v_EQ: np.ndarray, n: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """How far p is behind the plane through q with normal n, for an eye at the origin, less the noise of its depth.

    Noise along the ray counts as much as the ray is square to the plane. Without a normal, n = 0, it is infinite.
    """
    ray = np.einsum("ij,ij->i", n, v_EQ)
    depth = np.einsum("ij,ij->i", n, v_EP - v_EQ) * np.sign(ray)
    depth -= noise * np.abs(ray) / np.linalg.norm(v_EQ, axis=1)
    return np.where(_known(n), depth, np.float32(np.inf))


@dataclass(frozen=True, eq=False)
class _Directions:
    """Points about the eye: azimuth a and elevation b [rad], distance [m], (N,) float32 each."""

    a: np.ndarray
    b: np.ndarray
    distance: np.ndarray

    @staticmethod
    def of(p_FP: np.ndarray) -> "_Directions":
        x, y, z = p_FP
        level = np.sqrt(x * x + z * z)
        return _Directions(np.arctan2(x, z), np.arctan2(y, level), np.sqrt(level * level + y * y))

    def subset(self, chosen: np.ndarray) -> "_Directions":
        return _Directions(self.a[chosen], self.b[chosen], self.distance[chosen])


def _facing(v_EP: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) into a frame F whose z axis points at the middle of the points, away from the poles of angles."""
    distance = np.maximum(np.linalg.norm(v_EP, axis=1, keepdims=True), np.float32(1e-6))
    z = (v_EP / distance).mean(axis=0, dtype=float)
    length = np.linalg.norm(z)
    z = z / length if length > 1e-3 else np.array([1.0, 0, 0])
    x = np.cross(np.eye(3)[np.abs(z).argmin()], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def _within(p_FQ: np.ndarray, bounds: list[tuple[float, float]], margin: float) -> np.ndarray:
    """Which points can be within the bounds of azimuth and elevation, give or take the margin; never too few."""
    x, y, z = p_FQ
    (a0, a1), (b0, b1) = [(low - margin, high + margin) for low, high in bounds]
    if max(abs(a0), abs(a1), abs(b0), abs(b1)) > np.deg2rad(80):
        return np.isfinite(x)
    # tan b = y / sqrt(x² + z²), and z <= sqrt(x² + z²) <= z / cos a.
    longest = 1 / np.cos(max(abs(a0), abs(a1)))
    low = np.float32(np.tan(b0) * (longest if b0 < 0 else 1.0))
    high = np.float32(np.tan(b1) * (longest if b1 > 0 else 1.0))
    inside = (z > 0) & (x >= np.float32(np.tan(a0)) * z) & (x <= np.float32(np.tan(a1)) * z)
    return inside & (y >= low * z) & (y <= high * z)


def _spacing(source: _Directions) -> np.ndarray:
    """Angle between a point and its neighbours at about the same distance [rad], (N,).

    Counted in cells of 3 degrees and half octaves of distance. The fullest of the cells around counts, because the
    cell at the edge of a surface is only partly filled, and of two sets of half octaves, so that no surface is halved.
    """
    column = ((source.a - source.a.min()) / _COARSE).astype(np.intp)
    row = ((source.b - source.b.min()) / _COARSE).astype(np.intp)
    octaves = 2 * np.log2(source.distance) + 8
    shape = (24, int(row.max()) + 1, int(column.max()) + 1)
    fullest = np.zeros(len(column), np.intp)
    for shift in (0.0, 0.5):
        band = np.clip(octaves + np.float32(shift), 0, 23).astype(np.intp)
        flat = (band * shape[1] + row) * shape[2] + column
        count = np.bincount(flat, minlength=int(np.prod(shape))).reshape(shape)
        around = -_smallest_around(_smallest_around(-count, 1), 2)
        np.maximum(fullest, around.ravel()[flat], out=fullest)
    return _COARSE / np.sqrt(fullest, dtype=np.float32)


def _look_up(
    source: _Directions, index: np.ndarray, target: _Directions, bounds: list[tuple[float, float]], cell: float
) -> np.ndarray:
    """Key of the nearest source point in the cell of every target, `_EMPTY` where there is none, (N,) int64."""
    margin = _SPREAD + 1
    (a0, a1), (b0, b1) = bounds
    width, height = (int((high - low) / cell) + 2 * margin + 1 for low, high in ((a0, a1), (b0, b1)))

    def cells(at: _Directions) -> np.ndarray:
        """What is outside goes to the edge, from where it does not reach any target."""
        column = (at.a - np.float32(a0)) * np.float32(1 / cell) + margin
        row = (at.b - np.float32(b0)) * np.float32(1 / cell) + margin
        rows = np.clip(row, 0, height - 1, out=row).astype(np.int32)
        return rows * np.int32(width) + np.clip(column, 0, width - 1, out=column).astype(np.int32)

    grid = np.full(height * width, _EMPTY)
    keys = ((source.distance * np.float32(_STEPS)).astype(np.int64) << _INDEX_BITS) | index
    np.minimum.at(grid, cells(source), keys)
    nearest = grid.reshape(height, width)
    for axis in (0, 1):
        for _ in range(_SPREAD):
            nearest = _smallest_around(nearest, axis)
    return nearest.ravel()[cells(target)]


def _smallest_around(grid: np.ndarray, axis: int) -> np.ndarray:
    """The smallest of every entry and its two neighbours along an axis."""
    smallest = grid.copy()
    before, after = ((slice(None),) * axis + (part,) for part in (slice(None, -1), slice(1, None)))
    np.minimum(smallest[after], grid[before], out=smallest[after])
    np.minimum(smallest[before], grid[after], out=smallest[before])
    return smallest
