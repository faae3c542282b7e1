"""Recorded scans: find them, read one, write a cloud."""

import os
import re
from pathlib import Path

import numpy as np
import open3d as o3d
from open3d.t.geometry import PointCloud

from ..errors import ScanFileError
from ..files import replacing
from .cloud_formats import READERS, Columns

SCAN_SUFFIXES = tuple(READERS)
_TENSOR_TYPES = {np.dtype(name) for name in ("f4", "f8", "u1", "u2", "u4", "u8", "i1", "i2", "i4", "i8")}
# Three columns that belong together, under the name that Open3D gives them.
_VECTORS = {
    "normals": (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z")),
    "colors": (("red", "green", "blue"),),
}


def list_scans(path: str | os.PathLike[str]) -> list[Path]:
    """Lists the scans of a folder in natural order (2 before 10), or the one file that `path` is.

    Files of other kinds in the folder (poses, notes) are ignored.

    Raises:
        ScanFileError: nothing there, no scan in the folder, scans of several kinds, or a file of an unknown kind.
    """
    path = Path(path)
    if path.is_file():
        if path.suffix.lower() not in SCAN_SUFFIXES:
            raise ScanFileError("unknown kind of scan", where=path, value=path.suffix, valid=SCAN_SUFFIXES)
        return [path]
    if not path.is_dir():
        raise ScanFileError("no such file or folder", where=path)
    files = [file for file in path.iterdir() if file.is_file() and not file.name.startswith(".")]
    scans = [file for file in files if file.suffix.lower() in SCAN_SUFFIXES]
    if not scans:
        problem = "no scans in this folder" if files else "the folder is empty"
        found = sorted({file.suffix for file in files}) or None
        raise ScanFileError(problem, where=path, value=found, valid=SCAN_SUFFIXES)
    suffixes = sorted({file.suffix.lower() for file in scans})
    if len(suffixes) > 1:
        raise ScanFileError("scans of several kinds in one folder", where=path, value=suffixes, valid="one of them")
    return sorted(scans, key=lambda file: _natural_key(file.name))


def _natural_key(name: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name) if part]


def read_scan(path: str | os.PathLike[str]) -> PointCloud:
    """Reads one scan: positions (N, 3) float32 [m] and every per-point attribute as (N, k) in the type of the file.

    Points with a coordinate that is NaN or infinite (no return) are dropped. .npz needs `xyz`, `points` or `positions`.

    Raises:
        ScanFileError: missing, of an unknown kind, ends early, not a scan, or without one usable point.
    """
    path = Path(path)
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise ScanFileError("unknown kind of scan", where=path, value=path.suffix, valid=SCAN_SUFFIXES)
    try:
        columns = reader(path)
        return _make_cloud(columns)
    except FileNotFoundError:
        raise ScanFileError("no such file", where=path) from None
    except OSError as error:
        raise ScanFileError(f"cannot be read ({error.strerror or error})", where=path) from None
    except ValueError as error:
        raise ScanFileError(" ".join(str(error).split()), where=path) from None


def _make_cloud(columns: Columns) -> PointCloud:
    missing = [axis for axis in "xyz" if axis not in columns]
    if missing:
        raise ValueError(f"not a scan: no column {', '.join(missing)}, only {', '.join(columns)}")
    if len(columns["x"]) == 0:
        raise ValueError("zero points")
    with np.errstate(over="ignore"):  # a float64 that float32 cannot hold becomes infinite and is dropped
        points = np.stack([np.asarray(columns.pop(axis), np.float32) for axis in "xyz"], axis=1)
    keep = np.isfinite(points).all(axis=1)
    if not keep.any():
        raise ValueError(f"none of its {len(points)} points is finite")
    cloud = PointCloud(o3d.core.Tensor(np.ascontiguousarray(points[keep])))
    for name, triples in _VECTORS.items():
        for triple in triples:
            if all(part in columns for part in triple):
                columns[name] = np.stack([columns.pop(part) for part in triple], axis=1)
    for name, values in columns.items():
        if name.startswith("_"):
            continue  # padding
        values = values.reshape(len(points), -1)[keep]
        values = values.astype(values.dtype.newbyteorder("=") if values.dtype.kind != "b" else np.uint8)
        if values.dtype in _TENSOR_TYPES and values.shape[1] > 0:
            cloud.point[name] = o3d.core.Tensor(np.ascontiguousarray(values))
    return cloud


def write_cloud(path: str | os.PathLike[str], cloud: PointCloud) -> None:
    """Writes `cloud` with its attributes as binary PLY. `path` holds the whole of it or what it held before.

    An attribute of several columns, such as `class_probabilities`, becomes one property a column: `<name>_0`, …

    Raises:
        ScanFileError: not a .ply path, an empty cloud, or a folder that cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() != ".ply":
        raise ScanFileError("clouds are written as PLY", where=path, value=path.suffix, valid=".ply")
    if cloud.is_empty():
        raise ScanFileError("a cloud without points cannot be written", where=path)
    if not path.parent.is_dir():
        raise ScanFileError("cannot be written (no such folder)", where=path)
    try:
        with replacing(path) as temporary:
            with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
                written = o3d.t.io.write_point_cloud(str(temporary), _single_columns(cloud))
            if not written:
                raise ScanFileError("cannot be written", where=path)
    except OSError as error:
        raise ScanFileError(f"cannot be written ({error.strerror})", where=path) from None


def _single_columns(cloud: PointCloud) -> PointCloud:
    """`cloud` with attributes of one column each, which is all that PLY has; but for those that Open3D knows."""
    single = PointCloud()
    for name, values in cloud.point.items():
        if name in ("positions", "normals", "colors") or values.ndim != 2 or values.shape[1] <= 1:
            single.point[name] = values
        else:
            for column in range(values.shape[1]):
                single.point[f"{name}_{column}"] = values[:, column : column + 1].contiguous()
    return single
