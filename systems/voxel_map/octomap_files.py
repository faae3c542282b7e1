"""OctoMap's files: `.bt` (free and occupied) and `.ot` (log-odds, also with colours), read and written.

The format is that of OctoMap 1.10 (AbstractOcTree::write, OccupancyOcTreeBase::writeBinaryNode, OcTreeDataNode,
ColorOcTreeNode): a header of text up to the line `data`, then all nodes depth first, little-endian.
"""

import dataclasses
import os
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..files import replacing
from .carving import BLOCK, VOXELS
from .octree import (
    DEPTH,
    REACH,
    OctreeLeaves,
    decode_binary,
    decode_full,
    encode_binary,
    encode_full,
    morton_codes,
    morton_indices,
)
from .voxel_map import VoxelMap
from .voxel_map_config import VoxelMapConfig
from .voxel_view import VoxelView

_FIRST = {".bt": b"# Octomap OcTree binary file", ".ot": b"# Octomap OcTree file"}
_KINDS = ("OcTree", "ColorOcTree")
# A file of a few bytes can state more voxels than fit into any memory.
_MOST_VOXELS = 1 << 28


class MapFileError(InputError):
    """A file of a voxel map cannot be read or written; `key` is the field."""


def write_octomap(path: str | os.PathLike[str], voxels: VoxelView, *, colours: np.ndarray | None = None) -> None:
    """Writes what is known of `voxels` to a pruned `.bt` or `.ot` file, by the ending of `path`.

    A `.bt` file only says free or occupied. An `.ot` file has the log-odds, and with `colours` also the class: it is
    then a ColorOcTree, where occupied voxels have the colour of their most probable class.

    Args:
        colours: (K, 3) uint8, of each class.

    Raises:
        MapFileError: another ending, a folder that cannot be written, or voxels beyond 2^15 from zero.
        ValueError: `colours` do not fit the classes of the map.
    """
    path = Path(path)
    blocks, log_odds = voxels.blocks()
    reach = REACH // BLOCK
    if len(blocks) and not ((blocks >= -reach) & (blocks < reach)).all():
        farthest = (blocks[np.abs(blocks).max(axis=1).argmax()] * BLOCK).tolist()
        raise MapFileError("voxel out of reach of an OctoMap", where=path, key="data", value=farthest, valid="±32768")
    # Blocks are nodes of the tree, so they are sorted whole, and the voxels inside always in the same way.
    first = morton_codes(blocks * BLOCK)
    order, inside = np.argsort(first), morton_indices(np.arange(VOXELS)) + REACH
    ordered = log_odds[order][:, (inside[:, 0] * BLOCK + inside[:, 1]) * BLOCK + inside[:, 2]]
    known = np.isfinite(ordered)
    codes, log_odds = (first[order, None] + np.arange(VOXELS))[known], ordered[known]
    colour = None
    if colours is not None and path.suffix == ".ot":
        colours = np.asarray(colours, np.uint8)
        if colours.shape != (voxels.classes, 3):
            raise ValueError(f"colours {colours.shape} for {voxels.classes} classes")
        colour = np.full((len(codes), 3), 255, np.uint8)
        occupied = log_odds >= 0
        centres = (morton_indices(codes[occupied]) + 0.5) * voxels.voxel_size
        colour[occupied] = colours[np.argmax(voxels.class_posterior(centres), axis=1)]
    depth = np.full(len(codes), DEPTH, np.uint8)
    write_leaves(path, OctreeLeaves(voxels.voxel_size, codes, depth, log_odds, colour))


def read_octomap(path: str | os.PathLike[str], config: VoxelMapConfig | None = None) -> VoxelMap:
    """Reads a `.bt` or `.ot` file into a map of its voxel size; occupied and free of a `.bt` get the extreme log-odds.

    Args:
        config: how the map is kept from now on; its voxel size is replaced by that of the file.

    Raises:
        MapFileError: missing, damaged or another kind of file, or more than 2^28 voxels.
    """
    leaves = read_leaves(path)
    if leaves.voxels > _MOST_VOXELS:
        raise MapFileError("too many voxels", where=path, key="data", value=leaves.voxels, valid="up to 2^28")
    config = dataclasses.replace(config or VoxelMapConfig(), voxel_size=leaves.voxel_size)
    voxels = VoxelMap(config)
    indices, leaf = leaves.expanded()
    values = leaves.log_odds[leaf]
    if Path(path).suffix == ".bt":
        low, high = config.log_odds_steps()[2:]
        values = np.where(values >= 0, high, low)
    voxels.set_voxels(indices, values)
    return voxels


def write_leaves(path: str | os.PathLike[str], leaves: OctreeLeaves) -> None:
    """Writes `leaves`, pruned, to a `.bt` or `.ot` file, see `write_octomap`.

    Raises:
        MapFileError: another ending, or a folder that cannot be written.
    """
    path = Path(path)
    kind = "OcTree"
    if path.suffix == ".bt":
        occupied = leaves.log_odds >= 0
        pruned = OctreeLeaves(leaves.voxel_size, leaves.codes, leaves.depth, occupied.astype(np.float32)).pruned()
        data, nodes = encode_binary(pruned.codes, pruned.depth, pruned.log_odds > 0)
        content = data.tobytes()
    elif path.suffix == ".ot":
        pruned = leaves.pruned()
        colours = np.zeros((0, 3), np.uint8) if pruned.colours is None else pruned.colours
        kind = _KINDS[0] if pruned.colours is None else _KINDS[1]
        value, colour, children = encode_full(
            pruned.codes, pruned.depth, pruned.log_odds, colours, pruned.colours is not None
        )
        nodes = len(value)
        records = np.zeros(nodes, _record(kind))
        records["value"], records["children"] = value, children
        if pruned.colours is not None:
            records["colour"] = colour
        content = records.tobytes()
    else:
        raise MapFileError("unknown kind of voxel file", where=path, value=path.suffix, valid=list(_FIRST))
    head = (
        f"{_FIRST[path.suffix].decode()}\n# (feel free to add / change comments, but leave the first line as it is!)\n"
        f"#\nid {kind}\nsize {nodes}\nres {float(leaves.voxel_size)!r}\ndata\n"
    )
    try:
        with replacing(path) as temporary:
            temporary.write_bytes(head.encode() + content)
    except OSError as error:
        raise MapFileError(f"cannot be written ({error.strerror})", where=path) from None


def read_leaves(path: str | os.PathLike[str]) -> OctreeLeaves:
    """Reads the leaves of a `.bt` or `.ot` file; the log-odds of a `.bt` are -1 and 1.

    Raises:
        MapFileError: missing, damaged or another kind of file.
    """
    path = Path(path)
    if path.suffix not in _FIRST:
        raise MapFileError("unknown kind of voxel file", where=path, value=path.suffix, valid=list(_FIRST))
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise MapFileError("no such file", where=path) from None
    except OSError as error:
        raise MapFileError(f"cannot be read ({error.strerror})", where=path) from None
    fields, data = _split(content, path)
    kind, size, voxel_size = fields["id"], _count(fields["size"], path), _length(fields["res"], path)
    if kind not in _KINDS:
        raise MapFileError("unknown kind of tree", where=path, key="id", value=kind, valid=_KINDS)
    colours = None
    if size == 0 and len(data) == 0:
        codes, depth, log_odds = np.zeros(0, np.int64), np.zeros(0, np.uint8), np.zeros(0, np.float32)
        return OctreeLeaves(voxel_size, codes, depth, log_odds)
    if path.suffix == ".bt":
        codes, depth, occupied, nodes, used = decode_binary(np.frombuffer(data, np.uint8))
        log_odds = np.where(occupied > 0, 1.0, -1.0).astype(np.float32)
    else:
        width = _record(kind).itemsize
        records = np.frombuffer(data[: len(data) // width * width], _record(kind))
        codes, depth, which, nodes = decode_full(np.ascontiguousarray(records["children"]))
        used = nodes * width
        log_odds = records["value"][which].copy()
        if kind == "ColorOcTree":
            colours = records["colour"][which].copy()
    if nodes == -1:
        raise MapFileError("the file ends before the tree does", where=path, key="data", value=f"{len(data)} bytes")
    if nodes == -2:
        raise MapFileError("the tree has more than 16 levels", where=path, key="data")
    if nodes != size:
        raise MapFileError("the tree has another number of nodes", where=path, key="size", value=size, valid=str(nodes))
    if used != len(data):
        raise MapFileError(f"{len(data) - used} bytes more than the tree needs", where=path, key="data")
    if not np.isfinite(log_odds).all():
        raise MapFileError("a log-odds value is not finite", where=path, key="data")
    return OctreeLeaves(voxel_size, codes, depth, log_odds, colours)


def _record(kind: str) -> np.dtype:
    colour = [("colour", "u1", 3)] if kind == "ColorOcTree" else []
    return np.dtype([("value", "<f4"), *colour, ("children", "u1")])


def _split(content: bytes, path: Path) -> tuple[dict[str, str], bytes]:
    """Fields of the header, and what comes after it."""
    fields: dict[str, str] = {}
    line, _, rest = content.partition(b"\n")
    if not line.startswith(_FIRST[path.suffix]):
        raise MapFileError("not an OctoMap file", where=path, key="first line", valid=_FIRST[path.suffix].decode())
    while rest:
        line, _, rest = rest.partition(b"\n")
        words = line.split()
        if words and words[0] == b"data":
            break
        if words and not line.startswith(b"#"):
            fields[words[0].decode("ascii", "replace")] = b" ".join(words[1:]).decode("ascii", "replace")
    else:
        raise MapFileError("missing", where=path, key="data")
    for name in ("id", "size", "res"):
        if name not in fields:
            raise MapFileError("missing", where=path, key=name)
    return fields, rest


def _count(text: str, path: Path) -> int:
    if not text.isdecimal():
        raise MapFileError("not a number of nodes", where=path, key="size", value=text)
    return int(text)


def _length(text: str, path: Path) -> float:
    try:
        length = float(text)
    except ValueError:
        length = 0.0
    if not 0 < length < np.inf:
        raise MapFileError("not a length", where=path, key="res", value=text, valid="> 0 m")
    return length
