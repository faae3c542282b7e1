"""An earlier survey: read from its folder, and new keyframes laid on its map."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import open3d as o3d
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform
from scipy.spatial import KDTree

from ..clouds import transform_points
from ..errors import ScanFileError
from ..registration import register
from ..sensing.scan_files import read_scan
from .seen_space import SeenSpace, read_seen
from .survey_changes import VANISHED, SurveyUpdateConfig, free_around, map_normals

MAP_FILE, SEEN_FILE = "survey_map.ply", "survey_seen.npz"


@dataclass(frozen=True, eq=False)
class EarlierSurvey:
    """A survey to be brought up to date. Read-only.

    Attributes:
        map_M: its map, with attributes, without what had vanished.
        seen: the space it saw free, in M.
        survey: number of its last survey, 0 for the first.
    """

    map_M: PointCloud
    seen: SeenSpace
    survey: int

    def __deepcopy__(self, memo: dict) -> "EarlierSurvey":
        return self


def read_survey(folder: str | os.PathLike[str]) -> EarlierSurvey:
    """Reads `survey_map.ply` and `survey_seen.npz` from the folder of an earlier survey or of an updated one.

    Raises:
        ScanFileError: no such folder, a file that is missing or damaged, or a map without a point that is still there.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ScanFileError("no such folder", where=folder, valid=f"a folder with {MAP_FILE} and {SEEN_FILE}")
    return earlier_survey(read_scan(folder / MAP_FILE), read_seen(folder / SEEN_FILE), where=folder / MAP_FILE)


def earlier_survey(map_M: PointCloud, seen: SeenSpace, *, where: object = "earlier survey") -> EarlierSurvey:
    """Drops points that are not finite or had vanished already.

    Raises:
        ScanFileError: no point is left, or `survey` is not a number; it names `where`.
    """
    if "positions" not in map_M.point:
        raise ScanFileError("the map has no points", where=where)
    points = map_M.point.positions.numpy()
    keep = np.isfinite(points).all(axis=1)
    if "change" in map_M.point:
        keep &= map_M.point["change"].numpy()[:, 0] != VANISHED
    if not keep.any():
        raise ScanFileError("no point is finite and still there", where=where, value=len(points), valid="1 or more")
    kept = map_M.select_by_mask(o3d.core.Tensor(keep))
    numbers = kept.point["survey"].numpy().ravel() if "survey" in kept.point else np.zeros(1)
    if not (np.isfinite(numbers).all() and numbers.min() >= 0 and numbers.max() < 65535):
        raise ScanFileError("not the number of a survey", where=where, key="survey", valid="0 to 65534")
    return EarlierSurvey(kept, seen, int(numbers.max()))


@dataclass(frozen=True, eq=False)
class Alignment:
    """How new keyframes lie on the earlier map.

    Attributes:
        X_MK: pose in M of K, the frame that the new keyframes call their map; the guess when `valid` is False.
        fitness, inlier_rmse: of the registration, [0, 1] and [m]; 0 and inf when it failed.
        agreement: part of the upright surfaces, seen where the earlier survey had looked too, that were there, [0, 1].
        correction: distance that the new map's middle moved [m], and correction_deg the angle [deg].
        valid: whether both are of the same place; `reason` says why not, or what the geometry does not hold.
    """

    X_MK: RigidTransform
    fitness: float
    inlier_rmse: float
    agreement: float
    correction: float
    correction_deg: float
    valid: bool
    reason: str

    def __deepcopy__(self, memo: dict) -> "Alignment":
        return self


def align_to_earlier(
    new_K: PointCloud,
    earlier: EarlierSurvey,
    config: SurveyUpdateConfig | None = None,
    X_MK_guess: RigidTransform | None = None,
) -> Alignment:
    """Registers the new map `new_K` to the earlier one; nothing here raises, what fails says why.

    ICP would lay any floor on any other. So the upright surfaces of the new map are asked: each that is within
    `tolerance` of the earlier map agrees, each in space that the earlier survey saw free contradicts.
    """
    config = config or SurveyUpdateConfig()
    guess = X_MK_guess or RigidTransform()
    result = register(new_K, earlier.map_M, guess, config.alignment)
    if not result.valid:
        return Alignment(guess, 0.0, float("inf"), 0.0, 0.0, 0.0, False, result.reason)
    points = new_K.point.positions.numpy()
    p_MP = transform_points(result.X_TS.GetAsMatrix4(), points[np.isfinite(points).all(axis=1)].astype(float))
    normals = map_normals(p_MP, config.alignment.icp.normal_radius)
    upright = (normals != 0).any(axis=1) & (np.abs(normals[:, 2]) < 0.5)
    p_MP = p_MP[upright]
    there = _near(p_MP, earlier.map_M.point.positions.numpy(), config.tolerance)
    against = ~there & (free_around(p_MP, earlier.seen, config.seen.margin) > 0)
    agreement = float(there.sum() / max(there.sum() + against.sum(), 1))
    change = guess.inverse() @ result.X_TS
    middle = points[np.isfinite(points).all(axis=1)].mean(axis=0).astype(float)
    moved = float(np.linalg.norm(change.multiply(middle) - middle))
    turned = float(np.rad2deg(abs(change.rotation().ToAngleAxis().angle())))
    valid, reason = True, result.reason
    if agreement < config.min_agreement:
        valid = False
        reason = f"another place: {agreement:.0%} of the upright surfaces agree, needs {config.min_agreement:.0%}"
    X_MK = result.X_TS if valid else guess
    return Alignment(X_MK, result.fitness, result.inlier_rmse, agreement, moved, turned, valid, reason)


def _near(points: np.ndarray, others: np.ndarray, distance: float) -> np.ndarray:
    return (
        KDTree(others).query(points, distance_upper_bound=distance)[0] <= distance if len(points) else np.zeros(0, bool)
    )
