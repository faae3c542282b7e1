"""Our registration: surfels of one cloud laid on those of another, coarse to fine."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform, RotationMatrix

from ..clouds import transform_points
from .alignment import Alignment, nothing_found
from .alignment_kernels import lay_on
from .class_correlation import correlate_classes, moved_along
from .config import RegistrationConfig, SurfacesConfig
from .constraint import hold_from_sums
from .grid_kernels import sort_into_cells
from .sight_kernels import count_seen
from .surfels import Surfels, surfels_of, usable_points

# Part of the points that make no plane, from which on a scene is clutter.
_WILD = 0.5
# How the width of the loss shrinks there.
_SLOWLY = 0.92
# Surfels that share neighbours are not quite one: with this, the normalised error squared of scans in simulated rooms
# is 4 to 7 (6 would be exact) and of scans on a map of means 7 to 9, see the tests of uncertainty.
_SHARED = 0.85
# At most so many motions are searched with classes.
_MOST_FREE = 2


class SearchGrid(NamedTuple):
    """Surfels (N, 8) sorted into cells of edge length `cell` [m]; all within half of it are found.

    `evidence` (N, K): class probabilities over the shares of the classes; the sum of its products with those of another
    point is the likelihood ratio of one place against two.
    """

    surfels: np.ndarray
    evidence: np.ndarray
    keys: np.ndarray
    ends: np.ndarray
    cell: float


@dataclass(frozen=True, eq=False)
class SurfaceCloud:
    """A cloud as surfels, and its points (N, 3) with class probabilities (N, K); none where it has no classes."""

    surfels: Surfels
    points: np.ndarray
    probabilities: np.ndarray

    def __len__(self) -> int:
        return len(self.surfels)


@dataclass(frozen=True, eq=False)
class SurfaceTarget:
    """A cloud that others are laid on: its surfels can be searched coarsely and finely."""

    cloud: SurfaceCloud
    coarse: SearchGrid
    fine: SearchGrid

    def __len__(self) -> int:
        return len(self.cloud.surfels)


def prepare_surfaces(cloud: PointCloud, config: RegistrationConfig) -> SurfaceCloud:
    """The surfels and classes of a cloud that is to be registered."""
    return SurfaceCloud(surfels_of(cloud, config.surfaces), *_class_points(cloud, config.surfaces))


def prepare_surface_target(cloud: PointCloud, config: RegistrationConfig) -> SurfaceTarget:
    """Those of a cloud that others will be registered to, with grids to search them."""
    return _searchable(prepare_surfaces(cloud, config), config.surfaces)


def _searchable(cloud: SurfaceCloud, config: SurfacesConfig) -> SurfaceTarget:
    surfels = cloud.surfels
    evidence = surfels.probabilities / _shares(cloud.probabilities)
    some = slice(None, None, config.first_stride)
    return SurfaceTarget(
        cloud,
        _grid(surfels.data[some], evidence[some], 2 * config.first_reach),
        _grid(surfels.data, evidence, 2 * config.last_reach),
    )


def align_surfaces(
    source: SurfaceCloud, target: SurfaceTarget, X_TS: RigidTransform, config: RegistrationConfig, first_width: float
) -> Alignment:
    """Lays the source on the target, starting at the pose X_TS.

    Each iteration pairs every surfel with the nearest one whose normal agrees, and takes a Gauss-Newton step on their
    distance along the mean of both normals (symmetric point-to-plane: Rusinkiewicz, A symmetric objective function for
    ICP, 2019) under a Tukey loss that becomes narrower from one to the next. The step goes only along motions that the
    surfaces hold (`min_constraint`): along the others X_TS stays what it was.

    Args:
        first_width: of the loss [m].
    """
    c, surfels = config.surfaces, source.surfels
    probabilities = surfels.probabilities
    if probabilities.shape[1] != target.fine.evidence.shape[1]:
        probabilities = np.zeros((len(surfels), 0))
    X, means, centre = lay_on(
        surfels.data,
        probabilities,
        target.coarse,
        target.fine,
        np.ascontiguousarray(X_TS.GetAsMatrix4()),
        surfels.centre,
        np.array([first_width, c.first_reach / 3, c.last_width, c.narrowing]),
        c.first_stride,
        c.max_iterations,
        c.tolerance,
        np.cos(np.deg2rad(c.max_angle_deg)),
        surfels.signed and target.cloud.surfels.signed,
        config.min_constraint,
        c.min_pairs,
    )
    pairs, weight, rmse = int(means[0]), means[1], float(np.sqrt(means[2]))
    if pairs == 0 or not np.isfinite(X).all():
        return nothing_found(X_TS)
    # As many surfels of the target as of the source take part.
    overlap = max(surfels.overlap, target.cloud.surfels.overlap * len(surfels) / len(target))
    X_TS = RigidTransform(RotationMatrix.ProjectToRotationMatrix(X[:3, :3]), X[:3, 3])
    return Alignment(
        X_TS,
        fitness=pairs / len(surfels),
        rmse=rmse,
        inliers=pairs,
        surfaces=pairs,
        hold=hold_from_sums(_symmetric(means[4:25], 6), means[31:34], _symmetric(means[34:40], 3), centre),
        tilt=means[3],
        variance=_SHARED * rmse**2 * overlap / weight,
        contradiction=_contradiction(surfels, target.cloud.surfels, X_TS),
    )


def with_clutter(
    source: SurfaceCloud,
    target: SurfaceTarget,
    X_TS: RigidTransform,
    alignment: Alignment,
    config: RegistrationConfig,
) -> tuple[SurfaceCloud, SurfaceTarget, RegistrationConfig] | None:
    """Both clouds with what makes no planes, where planes do not hold the pose and most of both is such: in a wood.

    A point of clutter is laid on the nearest one along all three axes, as three surfels. In a corridor this would hold
    it where it is, because points lie on the same rings, so it is left to scenes that have little else; else None.

    Args:
        X_TS: pose from which they will be aligned.
    """
    clouds = source.surfels, target.cloud.surfels
    wild = all(len(surfels.clutter) > _WILD * (len(surfels.clutter) + len(surfels)) for surfels in clouds)
    if not wild or (alignment.hold is not None and (alignment.hold.values >= config.min_constraint).all()):
        return None
    c = config.surfaces
    # Nearest points lead the way in small steps, and are never as near as planes are.
    surfaces = replace(
        c,
        first_width=2 * c.first_width,
        last_width=max(c.last_width, 2 * c.grain),
        narrowing=max(c.narrowing, _SLOWLY),
        max_iterations=3 * c.max_iterations,
    )
    all_S = _clutter_as_surfels(clouds[0], X_TS.rotation().matrix())
    all_T = replace(target.cloud, surfels=_clutter_as_surfels(clouds[1], np.eye(3)))
    return replace(source, surfels=all_S), _searchable(all_T, surfaces), replace(config, surfaces=surfaces)


def fix_by_classes(
    source: SurfaceCloud,
    target: SurfaceTarget,
    alignment: Alignment,
    config: RegistrationConfig,
    guess_covariance: np.ndarray | None = None,
) -> Alignment:
    """Asks the classes how far to go along motions that the surfaces do not hold, and lays the surfaces on again.

    The covariance of the guess, along these motions the pose so far, tells one of several like places from another.
    """
    hold = alignment.hold
    known = source.probabilities, target.cloud.probabilities
    if hold is None or not (len(known[0]) and len(known[1]) and known[0].shape[1] == known[1].shape[1]):
        return alignment
    free = hold.values - alignment.tilt < config.min_constraint
    if not 0 < np.count_nonzero(free) <= _MOST_FREE:
        return alignment
    motions = hold.motions[:, free].T.copy()
    motions[:, :3] /= hold.radius
    deviations = None
    if guess_covariance is not None:
        to_shares = np.linalg.inv(hold.at_point(alignment.X_TS.translation()))
        deviations = np.sqrt(np.diag(to_shares @ guess_covariance @ to_shares.T)[free])
    fix = correlate_classes(
        transform_points(alignment.X_TS.GetAsMatrix4(), source.points),
        source.probabilities,
        target.cloud.points,
        target.cloud.probabilities,
        _shares(*known),
        motions,
        config.surfaces.class_span,
        centre=hold.centre,
        deviations=deviations,
    )
    if not fix.distinct:
        return replace(alignment, fix=fix)
    X_TS = moved_along(alignment.X_TS, motions, fix.offsets, hold.centre)
    return replace(align_surfaces(source, target, X_TS, config, config.surfaces.last_width), fix=fix)


def _contradiction(source: Surfels, target: Surfels, X_TS: RigidTransform) -> float | None:
    """See `Alignment`."""
    there = through = 0
    for seen, by, X in ((source, target, X_TS), (target, source, X_TS.inverse())):
        if by.ranges is not None:
            counts = count_seen(seen.data, np.ascontiguousarray(X.GetAsMatrix4()), by.ranges)
            there, through = there + counts[0], through + counts[1]
    return through / (there + through) if there + through else None


def _clutter_as_surfels(surfels: Surfels, R: np.ndarray) -> Surfels:
    """Surfels and clutter, each point of it as three surfels across the rows of R."""
    points = [np.hstack([surfels.clutter, np.tile([*axis, 0.0, 1.0], (len(surfels.clutter), 1))]) for axis in R]
    data = np.vstack([surfels.data, *points])
    return Surfels(data, np.zeros((len(data), 0)), False, surfels.overlap)


def _grid(surfels: np.ndarray, evidence: np.ndarray, cell: float) -> SearchGrid:
    keys, ends, order, _ = sort_into_cells(np.ascontiguousarray(surfels[:, :3]), cell)
    return SearchGrid(surfels[order], evidence[order], keys, ends, cell)


def _class_points(cloud: PointCloud, config: SurfacesConfig) -> tuple[np.ndarray, np.ndarray]:
    if not config.classes or "class_probabilities" not in cloud.point:
        return np.zeros((0, 3)), np.zeros((0, 0))
    usable = usable_points(cloud)
    probabilities = cloud.point["class_probabilities"].numpy()[usable].astype(float)
    known = np.isfinite(probabilities.sum(axis=1))
    return cloud.point.positions.numpy()[usable][known].astype(float), probabilities[known]


def _shares(*probabilities: np.ndarray) -> np.ndarray:
    """Shares of the classes, (K,), none of them nothing."""
    rows = np.vstack(probabilities)
    shares: np.ndarray = np.maximum(rows.mean(axis=0) if len(rows) else np.ones(rows.shape[1]), 1e-6)
    return shares / max(float(shares.sum()), 1e-6)


def _symmetric(upper: np.ndarray, size: int) -> np.ndarray:
    matrix = np.zeros((size, size))
    matrix[np.triu_indices(size)] = upper
    return matrix + np.triu(matrix, 1).T
