"""What every method of registration finds, before it is judged."""

from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform

from .class_correlation import ClassFix
from .constraint import Hold, hold_of

# Normals from neighbours have so many of them in common with others, and so do their errors.
_NEIGHBOURS = 20.0


@dataclass(frozen=True, eq=False)
class Alignment:
    """A pose, and how the clouds lie on each other there.

    Attributes:
        X_TS: pose of the source in the target.
        fitness: part of the source that are inliers, [0, 1].
        rmse: root mean square distance of the inliers [m].
        inliers, surfaces: how many points have a partner, and how many of these a normal.
        hold: how firmly they hold the pose; None without surfaces.
        tilt: variance of their normals [rad²]: that much of a motion seems to be felt where nothing holds it.
        variance: of the distance of inliers along their normals, over the number of independent ones [m²].
        contradiction: of the surfels that are where the other cloud's sensor looked, the part that it saw through; None
            where neither cloud says from where it was seen.
        fix: what classes say of motions that the geometry does not hold; None when they were not asked.
    """

    X_TS: RigidTransform
    fitness: float
    rmse: float
    inliers: int
    surfaces: int
    hold: Hold | None
    tilt: float = 0.0
    variance: float = 0.0
    contradiction: float | None = None
    fix: ClassFix | None = None


def nothing_found(X_TS: RigidTransform) -> Alignment:
    """No point has a partner."""
    return Alignment(X_TS, 0.0, float("inf"), 0, 0, None)


def point_alignment(
    X_TS: RigidTransform, count: int, p_TS: np.ndarray, p_TT: np.ndarray, normals: np.ndarray
) -> Alignment:
    """How points lie on points.

    Args:
        count: number of points of the source.
        p_TS, p_TT: those that are partners, at the pose X_TS, (n, 3) each.
        normals: of p_TT, (n, 3), zero where there is none.
    """
    known = (normals != 0).any(axis=1)
    if not known.any():
        return nothing_found(X_TS)
    apart = p_TS - p_TT
    # Rounded because Open3D adds in the order in which its threads finish.
    variance = round(float(np.mean((apart[known] * normals[known]).sum(axis=1) ** 2)), 9)
    return Alignment(
        X_TS,
        fitness=len(p_TS) / count,
        rmse=round(float(np.sqrt((apart**2).sum(axis=1).mean())), 9),
        inliers=len(p_TS),
        surfaces=int(np.count_nonzero(known)),
        hold=hold_of(p_TS[known], normals[known]),
        variance=variance * _NEIGHBOURS / np.count_nonzero(known),
    )
