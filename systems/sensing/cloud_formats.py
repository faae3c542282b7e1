"""PLY, PCD, KITTI .bin and NumPy .npz point clouds as named columns, read strictly: a file that ends early is an error.

Open3D's own readers only warn when a PLY ends early and then return uninitialised memory, and read an unparsable number
of an ASCII PCD as 0. Each function here takes a path and returns `{field: (N,) or (N, k) array}`; what does not hold
together raises `ValueError` with the reason, to which `scan_files` adds the name of the file.
"""

import io
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import open3d as o3d

Columns = dict[str, np.ndarray]

PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
# No LiDAR sees so far: larger coordinates in a file without a header mean that the file is something else.
KITTI_MAX_COORDINATE = 1e4  # [m]


@dataclass
class _Element:
    """One element of a PLY header, with the name and NumPy type of each property (None for a list)."""

    name: str
    count: int
    properties: list[tuple[str, str | None]]


def read_ply(path: Path) -> Columns:
    """Vertices of an ASCII or binary PLY, one column a property."""
    data = path.read_bytes()
    if not data.startswith(b"ply"):
        raise ValueError("not a PLY file: it does not start with 'ply'")
    end = data.find(b"end_header")
    line_end = data.find(b"\n", end)
    if end < 0 or line_end < 0:
        raise ValueError("truncated: the PLY header does not end")
    encoding, elements = _parse_ply_header(data[:end].decode("ascii", "replace").splitlines()[1:])
    names = [element.name for element in elements]
    if "vertex" not in names:
        raise ValueError("not a scan: the PLY has no vertex element")
    vertex = elements[names.index("vertex")]
    before = elements[: names.index("vertex")]
    if any(kind is None for element in [*before, vertex] for _, kind in element.properties):
        raise ValueError("lists in or before the PLY vertices are not supported")
    body = data[line_end + 1 :]
    if encoding == "ascii":
        rows = body.decode("ascii", "replace").split("\n")[sum(element.count for element in before) :]
        return _parse_rows(rows, vertex.count, [(name, str(kind), 1) for name, kind in vertex.properties])
    order = "<" if encoding == "binary_little_endian" else ">"
    layouts = [
        np.dtype([(name, order + str(kind)) for name, kind in element.properties])
        for element in elements[: len(before) + 1]
    ]
    offset = sum(element.count * layout.itemsize for element, layout in zip(before, layouts, strict=False))
    return _unpack(body[offset:], layouts[-1], vertex.count)


def _parse_ply_header(lines: list[str]) -> tuple[str, list[_Element]]:
    encoding, elements = "", []
    for line in lines:
        words = line.split()
        try:
            match words[:1]:
                case ["format"]:
                    encoding = words[1]
                case ["element"]:
                    elements.append(_Element(words[1], int(words[2]), []))
                case ["property"]:
                    kind = None if words[1] == "list" else PLY_TYPES[words[1]]
                    elements[-1].properties.append((words[-1], kind))
        except (IndexError, KeyError, ValueError):
            raise ValueError(f"broken PLY header line '{line}'") from None
    if encoding not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise ValueError(f"unknown PLY format '{encoding}'")
    return encoding, elements


def read_pcd(path: Path) -> Columns:
    """Points of an ASCII, binary or binary_compressed PCD, one column a field."""
    data = path.read_bytes()
    header: dict[str, list[str]] = {}
    position = 0
    while "DATA" not in header:
        line_end = data.find(b"\n", position)
        if line_end < 0:
            raise ValueError("truncated: the PCD header does not end" if header else "not a PCD file")
        words = data[position:line_end].decode("ascii", "replace").split()
        position = line_end + 1
        if words and not words[0].startswith("#"):
            header[words[0]] = words[1:]
        if len(header) > 16:
            raise ValueError("not a PCD file: no DATA line in its header")
    try:
        names, sizes, kinds = header["FIELDS"], header["SIZE"], header["TYPE"]
        counts = [int(count) for count in header.get("COUNT", ["1"] * len(names))]
        points = int(header["POINTS"][0]) if "POINTS" in header else int(header["WIDTH"][0]) * int(header["HEIGHT"][0])
        fields = [
            (name if name != "_" else f"_{i}", {"F": "f", "I": "i", "U": "u"}[kind] + size, count)
            for i, (name, size, kind, count) in enumerate(zip(names, sizes, kinds, counts, strict=True))
        ]
        layout = np.dtype(
            [(name, "<" + kind, (count,)) if count > 1 else (name, "<" + kind) for name, kind, count in fields]
        )
        encoding = header["DATA"][0]
    except (KeyError, IndexError, ValueError, TypeError) as error:
        raise ValueError(f"broken PCD header ({error})") from None
    body = data[position:]
    if encoding == "ascii":
        return _parse_rows(body.decode("ascii", "replace").split("\n"), points, fields)
    if encoding == "binary":
        return _unpack(body, layout, points)
    if encoding == "binary_compressed":
        return _unpack_compressed(path, body, layout, points)
    raise ValueError(f"unknown PCD data '{encoding}'")


def _unpack_compressed(path: Path, body: bytes, layout: np.dtype, points: int) -> Columns:
    """Checks the sizes that the file states, then lets Open3D undo the LZF compression."""
    if len(body) < 8:
        raise ValueError(f"truncated: {points} points announced, none stored")
    compressed, size = np.frombuffer(body, "<u4", 2)
    if len(body) - 8 < compressed:
        raise ValueError(f"truncated: {compressed} compressed bytes announced, {len(body) - 8} there")
    if size != points * layout.itemsize:
        raise ValueError(f"{points} points need {points * layout.itemsize} bytes, the file holds {size}")
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        cloud = o3d.t.io.read_point_cloud(str(path))
    if "positions" not in cloud.point or len(cloud.point.positions) != points:
        raise ValueError("the compressed points cannot be unpacked")
    columns = {name: tensor.numpy() for name, tensor in cloud.point.items() if name != "positions"}
    return columns | {axis: cloud.point.positions.numpy()[:, i] for i, axis in enumerate("xyz")}


def read_kitti(path: Path) -> Columns:
    """Points of a KITTI Velodyne file: x, y, z, intensity as float32, without a header."""
    size = path.stat().st_size
    if size % 16:
        raise ValueError(f"truncated: {size} bytes are not a whole number of points of 16 bytes")
    values = np.fromfile(path, "<f4").reshape(-1, 4)
    finite = values[:, :3][np.isfinite(values[:, :3])]
    if finite.size and np.abs(finite).max() > KITTI_MAX_COORDINATE:
        raise ValueError(f"not a scan: coordinates up to {np.abs(finite).max():.3g} m")
    return {name: values[:, i] for i, name in enumerate(("x", "y", "z", "intensity"))}


def read_npz(path: Path) -> Columns:
    """Points under `xyz`, `points` or `positions`, (N, 3), and every numeric array that has one row a point."""
    data = path.read_bytes()
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except Exception as error:  # a damaged archive raises almost anything: zlib.error, KeyError, MemoryError, ...
        raise ValueError(f"not a readable .npz file ({error})") from None
    key = next((name for name in ("xyz", "points", "positions") if name in arrays), None)
    if key is None:
        raise ValueError(f"not a scan: has {sorted(arrays)}, needs one of xyz, points, positions")
    points = arrays.pop(key)
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "fiu":
        raise ValueError(f"not a scan: {key} is {points.dtype} {points.shape}, must be numbers (N, 3)")
    columns = {axis: points[:, i] for i, axis in enumerate("xyz")}
    per_point = {
        k: v for k, v in arrays.items() if v.ndim in (1, 2) and len(v) == len(points) and v.dtype.kind in "fiub"
    }
    return columns | per_point


def _parse_rows(rows: list[str], count: int, fields: list[tuple[str, str, int]]) -> Columns:
    width = sum(repeat for _, _, repeat in fields)
    words = [row.split() for row in rows[: count + 1]]
    words = [row for row in words if row][:count]
    if len(words) < count or (words and len(words[-1]) < width):
        raise ValueError(f"truncated: {count} points announced, {sum(len(row) >= width for row in words)} there")
    bad = next((i for i, row in enumerate(words) if len(row) != width), None)
    if bad is not None:
        raise ValueError(f"point {bad} has {len(words[bad])} values, must have {width}")
    try:
        table = np.array(words, dtype=float).reshape(count, width)
    except ValueError as error:
        raise ValueError(f"not a number in the points ({error})") from None
    columns, start = {}, 0
    for name, kind, repeat in fields:
        column = table[:, start] if repeat == 1 else table[:, start : start + repeat]
        columns[name] = column.astype(kind)
        start += repeat
    return columns


def _unpack(body: bytes, layout: np.dtype, count: int) -> Columns:
    if len(body) < count * layout.itemsize:
        there = math.floor(len(body) / max(layout.itemsize, 1))
        raise ValueError(f"truncated: {count} points announced, {there} there")
    table = np.frombuffer(body, layout, count)
    return {name: table[name] for name in layout.names or ()}


READERS: dict[str, Callable[[Path], Columns]] = {
    ".ply": read_ply,
    ".pcd": read_pcd,
    ".bin": read_kitti,
    ".npz": read_npz,
}
