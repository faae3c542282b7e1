"""`register`: the pose that lays one cloud on another, by any of the methods, and whether it can be used."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform, RollPitchYaw

from .alignment import Alignment
from .attribute_method import align_attributes, prepare_attribute_target, prepare_attributes
from .config import RegistrationConfig
from .open3d_icp import align_icp, prepare_icp, prepare_icp_target
from .result import Registration, rejected
from .surfaces import (
    SurfaceCloud,
    SurfaceTarget,
    align_surfaces,
    fix_by_classes,
    prepare_surface_target,
    prepare_surfaces,
    with_clutter,
)
from .surfels import usable_points
from .verdict import agreement, fits, judge

# With which part of the usual width a search is tried again, one after the other.
_RETRIES = (0.5, 1.0, 1.5)


@dataclass(frozen=True, eq=False)
class Target:
    """A cloud that others are registered to, prepared once for many.

    Attributes:
        method: of registration that it was prepared for.
        usable: number of its points that are finite.
        prepared: what the method searches; None when there are too few.
    """

    method: str
    usable: int
    prepared: Any

    def __deepcopy__(self, memo: dict) -> "Target":
        return self


def prepare_target(cloud: PointCloud, config: RegistrationConfig | None = None) -> Target:
    """Prepares `cloud` as target of `register` with the same configuration; any cloud will do, an empty one too."""
    config = config or RegistrationConfig()
    usable = len(usable_points(cloud))
    enough = usable >= config.min_points
    return Target(config.method, usable, _method(config).prepare_target(cloud, config) if enough else None)


def register(
    source: PointCloud,
    target: PointCloud | Target,
    X_TS_guess: RigidTransform,
    config: RegistrationConfig | None = None,
    guess_covariance: np.ndarray | None = None,
) -> Registration:
    """Finds the pose X_TS that lays `source` (points in S) on `target` (points in T), starting at the guess.

    Nothing here raises: what fails returns the guess, `valid` False and the reason. Equal input gives equal bits.

    Args:
        source, target: clouds; what their attributes are used for is in `surfels_of`.
        config: how, see `RegistrationConfig`; a prepared target must have been prepared with it.
        guess_covariance: (6, 6) of the guess, as that of `Registration`; it then weighs in along every motion. Without,
            the guess counts only where nothing else says how far to go.
    """
    config = config or RegistrationConfig()
    if not np.isfinite(X_TS_guess.GetAsMatrix34()).all():
        return rejected(RigidTransform(), "the guess is not finite")
    if guess_covariance is not None and not _is_covariance(guess_covariance):
        return rejected(X_TS_guess, "the covariance of the guess is not positive definite")
    if not isinstance(target, Target):
        target = prepare_target(target, config)
    if target.method != config.method:
        return rejected(X_TS_guess, f"the target was prepared for {target.method}, not for {config.method}")
    for name, count in (("source", len(usable_points(source))), ("target", target.usable)):
        if count < config.min_points:
            return rejected(X_TS_guess, f"{name} has {count} usable points, needs {config.min_points}")
    method = _method(config)
    prepared = method.prepare_source(source, config)
    for name, count in (("source", len(prepared)), ("target", len(target.prepared))):
        if count < config.fewest:
            return rejected(X_TS_guess, f"{name} has {count} {method.made_of}, needs {config.fewest}")
    alignment = method.align(prepared, target.prepared, X_TS_guess, config, guess_covariance)
    return judge(alignment, X_TS_guess, guess_covariance, config)


def _align_surfaces(
    source: SurfaceCloud,
    target: SurfaceTarget,
    X_TS_guess: RigidTransform,
    config: RegistrationConfig,
    guess_covariance: np.ndarray | None,
) -> Alignment:
    """Surfaces first; where these do not hold the pose, what else there is: clutter, or classes."""

    def align(X_TS: RigidTransform, wider: float) -> Alignment:
        return align_surfaces(source, target, X_TS, config, wider * config.surfaces.first_width)

    best = _best_of_starts(align, X_TS_guess, config)
    if (wild := with_clutter(source, target, X_TS_guess, best, config)) is not None:
        all_S, all_T, loose = wild
        return align_surfaces(all_S, all_T, X_TS_guess, loose, loose.surfaces.first_width)
    return fix_by_classes(source, target, best, config, guess_covariance)


def _align_points(align: Callable[..., Alignment]) -> Callable[..., Alignment]:
    return lambda source, target, X_TS_guess, config, _: _best_of_starts(
        lambda X_TS, _: align(source, target, X_TS, config), X_TS_guess, config, widths=(1.0,)
    )


def _best_of_starts(
    align: Callable[[RigidTransform, float], Alignment],
    X_TS_guess: RigidTransform,
    config: RegistrationConfig,
    widths: tuple[float, ...] = _RETRIES,
) -> Alignment:
    """The alignment from the guess or, where that does not fit well, the best from the guess and its turns.

    Args:
        align: from a pose, with a search that is so many times wider than usual.
        widths: that are tried one after the other.
    """
    best = align(X_TS_guess, 1.0)
    for wider in widths:
        if fits(best, config):
            break
        straight = [0.0] if config.retry_yaws_deg and wider != 1 else []
        for yaw in straight + config.retry_yaws_deg:
            turned = align(X_TS_guess @ RigidTransform(RollPitchYaw(0, 0, np.deg2rad(yaw)), np.zeros(3)), wider)
            if agreement(turned, config) > agreement(best, config):
                best = turned
    return best


class _Method(NamedTuple):
    """Prepares clouds, aligns them, and says what the prepared ones are made of."""

    prepare_source: Callable[[PointCloud, RegistrationConfig], Any]
    prepare_target: Callable[[PointCloud, RegistrationConfig], Any]
    align: Callable[[Any, Any, RigidTransform, RegistrationConfig, np.ndarray | None], Alignment]
    made_of: str


def _method(config: RegistrationConfig) -> _Method:
    if config.method == "surfaces":
        return _Method(prepare_surfaces, prepare_surface_target, _align_surfaces, "surfels")
    if config.method == "attributes":
        return _Method(prepare_attributes, prepare_attribute_target, _align_points(align_attributes), "voxels")
    return _Method(prepare_icp, prepare_icp_target, _align_points(align_icp), "voxels")


def _is_covariance(matrix: np.ndarray) -> bool:
    if np.shape(matrix) != (6, 6) or not np.isfinite(matrix).all():
        return False
    return bool(np.linalg.eigvalsh(matrix).min() > 0)
