"""Which space the scans saw to be free, and when."""

import io
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import ScanFileError
from ..files import replacing
from .sight import Rays, SeenSpaceConfig

# A voxel's three indices are packed in 63 bits.
_BITS = 21
_HALF = 1 << (_BITS - 1)
# A grid around the sensor is kept as an array up to this many voxels; larger ones are sorted, which is slower.
_MAX_GRID = 1 << 26
_COLUMNS = {"keys": np.int64, "views": np.uint16, "survey": np.uint16, "time": np.float32}


def voxel_keys(points: np.ndarray, voxel: float) -> np.ndarray:
    """Key of the voxel of each point (N, 3), (N,) int64, in the order of `VoxelCloud`; -1 where it has none.

    That is where a point is not finite or more than 2^20 voxels from the origin.
    """
    points = np.asarray(points, float)
    with np.errstate(invalid="ignore"):
        inside = (np.abs(points) < _HALF * voxel).all(axis=1)  # False for NaN
    indices = np.floor(np.where(inside[:, None], points, 0.0) / voxel).astype(np.int64) + _HALF
    return np.where(inside, _pack(indices), -1)


def _pack(indices: np.ndarray) -> np.ndarray:
    return (indices[..., 0] << 2 * _BITS) | (indices[..., 1] << _BITS) | indices[..., 2]


def free_voxels(rays: Rays, config: SeenSpaceConfig | None = None) -> np.ndarray:
    """Keys of the voxels that the rays passed through, sorted, (V,) int64.

    Of rays that end in the same voxel one is followed, in steps of a voxel, from the sensor to `stop_short` before
    its end.
    """
    config = config or SeenSpaceConfig()
    step = config.voxel_size
    start = np.asarray(rays.p_MS, float)
    ends = rays.p_MP[np.unique(voxel_keys(rays.p_MP, step), return_index=True)[1]]
    along = ends - start.astype(np.float32)
    length = np.linalg.norm(along, axis=1)
    reach = np.minimum(length - np.float32(config.stop_short), np.float32(config.max_range))
    along, length, reach = (a[(reach > 0) & np.isfinite(length)] for a in (along, length, reach))
    if len(reach) == 0:
        return np.zeros(0, np.int64)
    counts = np.floor(reach / step).astype(np.int64) + 1
    ordinal = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    distance = ordinal.astype(np.float32) * np.float32(step)
    # In units of voxels from the voxel of the sensor, which float32 holds well however far the map reaches.
    origin = np.floor(start / step)
    direction = along / (length * np.float32(step))[:, None]
    cells = []
    for axis in range(3):
        offset = np.float32(start[axis] / step - origin[axis])
        cells.append(np.floor(np.repeat(direction[:, axis], counts) * distance + offset).astype(np.int32))
    low = np.array([cell.min() for cell in cells])
    shape = np.array([cell.max() for cell in cells]) - low + 1
    if shape.astype(float).prod() <= _MAX_GRID:
        grid = np.zeros(shape, bool)
        grid.reshape(-1)[((cells[0] - low[0]) * shape[1] + (cells[1] - low[1])) * shape[2] + (cells[2] - low[2])] = True
        indices = np.stack(np.nonzero(grid), axis=-1) + low
    else:
        indices = np.stack(cells, axis=-1).astype(np.int64)
    indices = indices + (origin.astype(np.int64) + _HALF)
    keys = _pack(indices[((indices >= 0) & (indices < 2 * _HALF)).all(axis=1)])
    return keys if shape.astype(float).prod() <= _MAX_GRID else np.unique(keys)


@dataclass(frozen=True, eq=False)
class SeenSpace:
    """Voxels that rays passed through, sorted by key. Read-only.

    Attributes:
        voxel_size: edge length of a voxel [m].
        keys: (V,) int64, see `voxel_keys`.
        views: (V,) uint16, keyframes that saw it free, at most 65535.
        survey, time: (V,) uint16, float32 [s]: when it was last seen, as number of the survey and time within.
    """

    voxel_size: float
    keys: np.ndarray
    views: np.ndarray
    survey: np.ndarray
    time: np.ndarray

    def __deepcopy__(self, memo: dict) -> "SeenSpace":
        return self

    @property
    def volume(self) -> float:
        """[m³]"""
        return len(self.keys) * self.voxel_size**3

    def views_at(self, points: np.ndarray) -> np.ndarray:
        """How many keyframes saw the voxel of each point (N, 3) free, (N,) uint16; 0 in unseen space."""
        if len(self.keys) == 0:
            return np.zeros(len(points), np.uint16)
        wanted = voxel_keys(points, self.voxel_size)
        found = np.minimum(np.searchsorted(self.keys, wanted), len(self.keys) - 1)
        return np.where(self.keys[found] == wanted, self.views[found], 0).astype(np.uint16)

    def merge(self, other: "SeenSpace") -> "SeenSpace":
        """What either saw. Raises ValueError when the voxels differ in size."""
        if self.voxel_size != other.voxel_size:
            raise ValueError(f"voxels of {self.voxel_size:g} m and {other.voxel_size:g} m")
        columns = {name: np.concatenate([getattr(self, name), getattr(other, name)]) for name in _COLUMNS}
        order = np.lexsort((columns["time"], columns["survey"], columns["keys"]))
        return _one_a_voxel(self.voxel_size, {name: column[order] for name, column in columns.items()})


def make_seen_space(rays: Iterable[Rays], config: SeenSpaceConfig | None = None, *, survey: int = 0) -> SeenSpace:
    """The space that `rays` saw free in survey number `survey`."""
    config = config or SeenSpaceConfig()
    parts = [(free_voxels(bundle, config), bundle.time) for bundle in rays]
    keys = np.concatenate([np.zeros(0, np.int64), *(part for part, _ in parts)])
    times = np.repeat(np.array([time for _, time in parts], np.float32), [len(part) for part, _ in parts])
    order = np.lexsort((times, keys))
    ones = np.ones(len(keys), np.uint16)
    columns = {"keys": keys[order], "views": ones, "survey": ones * survey, "time": times[order]}
    return _one_a_voxel(config.voxel_size, columns)


def _one_a_voxel(voxel_size: float, columns: dict[str, np.ndarray]) -> SeenSpace:
    """Joins entries of one voxel; the last one is the latest."""
    keys = columns["keys"]
    if len(keys) == 0:
        return SeenSpace(voxel_size, *(np.zeros(0, kind) for kind in _COLUMNS.values()))
    starts = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
    last = np.append(starts[1:], len(keys)) - 1
    views = np.minimum(np.add.reduceat(columns["views"].astype(np.int64), starts), 65535).astype(np.uint16)
    return SeenSpace(voxel_size, keys[starts], views, columns["survey"][last].astype(np.uint16), columns["time"][last])


def write_seen(path: str | os.PathLike[str], seen: SeenSpace) -> None:
    """Writes `seen` as a compressed .npz file: about 3 bytes a voxel. `path` holds the whole of it or what it held.

    Raises:
        ScanFileError: not an .npz path, or a folder that cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() != ".npz":
        raise ScanFileError("seen space is written as NPZ", where=path, value=path.suffix, valid=".npz")
    steps = np.diff(seen.keys, prepend=np.int64(0))
    try:
        with replacing(path) as temporary:
            np.savez_compressed(
                temporary,
                voxel_size=np.float64(seen.voxel_size),
                key_steps=steps,
                views=seen.views,
                survey=seen.survey,
                time=seen.time,
            )
    except OSError as error:
        raise ScanFileError(f"cannot be written ({error.strerror})", where=path) from None


def read_seen(path: str | os.PathLike[str]) -> SeenSpace:
    """Reads what `write_seen` wrote.

    Raises:
        ScanFileError: missing, damaged, or not such a file.
    """
    path = Path(path)
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except FileNotFoundError:
        raise ScanFileError("no such file", where=path) from None
    except OSError as error:
        raise ScanFileError(f"cannot be read ({error.strerror or error})", where=path) from None
    except Exception as error:  # a damaged archive raises almost anything: zlib.error, KeyError, MemoryError, ...
        raise ScanFileError(f"not a readable .npz file ({error})", where=path) from None
    needed = ["voxel_size", "key_steps", "views", "survey", "time"]
    missing = [name for name in needed if name not in arrays]
    if missing:
        raise ScanFileError("not a record of seen space", where=path, key=missing[0], valid=needed)
    voxel_size, steps = arrays["voxel_size"], arrays["key_steps"]
    if voxel_size.shape != () or not 0 < float(voxel_size) < np.inf:
        raise ScanFileError("out of range", where=path, key="voxel_size", value=voxel_size.tolist(), valid="> 0 m")
    for name in needed[1:]:
        column = arrays[name]
        if column.shape != (steps.size,) or column.dtype.kind not in "iuf":
            raise ScanFileError("wrong shape or type", where=path, key=name, valid=f"{steps.size} numbers")
    if steps.dtype.kind not in "iu" or (steps.size and (steps[0] < 0 or (steps[1:] <= 0).any())):
        raise ScanFileError("keys are not rising", where=path, key="key_steps")
    columns = {name: arrays[name].astype(kind) for name, kind in _COLUMNS.items() if name != "keys"}
    return SeenSpace(float(voxel_size), np.cumsum(steps.astype(np.int64)), **columns)
