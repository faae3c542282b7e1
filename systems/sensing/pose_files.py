"""Trajectories in the TUM and KITTI text formats, and which pose belongs to which scan."""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ..errors import PoseFileError
from ..files import replacing

TUM = "TUM: time x y z qx qy qz qw"
KITTI = "KITTI: the 12 numbers of a 3x4 matrix, row by row"
# Text files round: a quaternion or a rotation matrix may be off by this much and is then made exact.
ROTATION_TOLERANCE = 0.01


@dataclass(frozen=True, eq=False)
class Poses:
    """A recorded trajectory.

    Attributes:
        times: (N,) [s], strictly increasing; None for a KITTI file.
        X_WS: (N, 4, 4), pose of the sensor (or whatever was tracked) in the world of the file.
    """

    times: np.ndarray | None
    X_WS: np.ndarray


def read_poses(path: str | os.PathLike[str]) -> Poses:
    """Reads a TUM (8 columns) or KITTI (12 columns) file. Blank lines and lines that start with # are skipped.

    Raises:
        PoseFileError: naming file and line.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise PoseFileError(f"cannot be read ({error.strerror})", where=path) from None
    except UnicodeDecodeError:
        raise PoseFileError("not a text file", where=path, valid=(TUM, KITTI)) from None
    rows: list[np.ndarray] = []
    times: list[float] = []
    poses: list[np.ndarray] = []
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        row = _parse_line(path, number, line, len(rows[0]) if rows else None)
        if len(row) == 8:
            if times and row[0] <= times[-1]:
                raise PoseFileError("time does not increase", where=path, key=f"line {number}", value=float(row[0]))
            times.append(float(row[0]))
        rows.append(row)
        poses.append(_pose_from_row(path, number, row))
    if not rows:
        raise PoseFileError("no poses in this file", where=path, valid=(TUM, KITTI))
    return Poses(np.array(times) if times else None, np.stack(poses))


def _parse_line(path: Path, number: int, line: str, columns: int | None) -> np.ndarray:
    key = f"line {number}"
    words = line.split()
    try:
        row = np.array([float(word) for word in words])
    except ValueError:
        raise PoseFileError("not a number", where=path, key=key, value=line.strip()[:80]) from None
    if len(row) not in (8, 12):
        raise PoseFileError("wrong number of columns", where=path, key=key, value=len(row), valid=(TUM, KITTI))
    if columns is not None and len(row) != columns:
        raise PoseFileError("wrong number of columns", where=path, key=key, value=len(row), valid=columns)
    if not np.isfinite(row).all():
        raise PoseFileError("not a finite number", where=path, key=key, value=line.strip()[:80])
    return row


def _pose_from_row(path: Path, number: int, row: np.ndarray) -> np.ndarray:
    X = np.eye(4)
    if len(row) == 8:
        norm = math.sqrt(float(row[4:] @ row[4:]))
        if abs(norm - 1) > ROTATION_TOLERANCE:
            raise PoseFileError("not a unit quaternion", where=path, key=f"line {number}", value=row[4:].tolist())
        X[:3, :3] = Rotation.from_quat(row[4:]).as_matrix()
        X[:3, 3] = row[1:4]
        return X
    matrix = row.reshape(3, 4)
    R = matrix[:, :3]
    if np.abs(R @ R.T - np.eye(3)).max() > ROTATION_TOLERANCE or np.linalg.det(R) < 0:
        raise PoseFileError("not a rotation matrix", where=path, key=f"line {number}", value=R.tolist())
    X[:3, :3] = Rotation.from_matrix(R).as_matrix()
    X[:3, 3] = matrix[:, 3]
    return X


def write_tum(
    path: str | os.PathLike[str], times: Sequence[float] | np.ndarray, poses: Sequence[np.ndarray] | np.ndarray
) -> None:
    """Writes poses (N, 4, 4) at `times` (N,) [s]. `path` holds the whole of it or what it held before.

    Raises:
        PoseFileError: the lengths differ, or the folder cannot be written.
    """
    path = Path(path)
    X = np.asarray(poses, dtype=float).reshape(-1, 4, 4)
    if len(X) != len(times):
        raise PoseFileError(f"{len(times)} times for {len(X)} poses", where=path)
    quaternions = Rotation.from_matrix(X[:, :3, :3]).as_quat() if len(X) else np.zeros((0, 4))
    lines = ["# time x y z qx qy qz qw"]
    for time, pose, q in zip(times, X, quaternions, strict=True):
        values = " ".join(f"{value:.9f}" for value in (*pose[:3, 3], *q))
        lines.append(f"{time:.6f} {values}")
    try:
        with replacing(path) as temporary:
            temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise PoseFileError(f"cannot be written ({error.strerror})", where=path) from None


def associate(
    poses: Poses, scan_count: int, scan_times: np.ndarray | None = None, *, max_gap: float = 0.05, where: object = ""
) -> tuple[np.ndarray, np.ndarray]:
    """Says which scans have a recorded pose.

    By index when there are as many poses as scans; else the pose nearest in time, at most `max_gap` [s] away.

    Returns:
        Indices of the scans that have a pose, (K,), and their poses X_WS, (K, 4, 4).

    Raises:
        PoseFileError: the counts differ and there are no times to go by, or no scan has a pose near it in time.
    """
    if len(poses.X_WS) == scan_count:
        return np.arange(scan_count), poses.X_WS
    counts = f"{len(poses.X_WS)} poses for {scan_count} scans"
    if poses.times is None or scan_times is None:
        lacking = "poses" if poses.times is None else "scans"
        raise PoseFileError(
            f"{counts}, and the {lacking} have no times", where=where, valid="one pose a scan, or times"
        )
    wanted = np.asarray(scan_times, dtype=float)
    after = np.clip(np.searchsorted(poses.times, wanted), 1, max(len(poses.times) - 1, 1))
    candidates = np.clip(np.stack([after - 1, after]), 0, len(poses.times) - 1)
    gaps = np.abs(poses.times[candidates] - wanted)
    nearest = candidates[gaps.argmin(axis=0), np.arange(len(wanted))]
    scans = np.flatnonzero(gaps.min(axis=0) <= max_gap)
    if len(scans) == 0:
        raise PoseFileError(f"{counts}, and none within {max_gap:g} s of a scan", where=where)
    return scans, poses.X_WS[nearest[scans]]
