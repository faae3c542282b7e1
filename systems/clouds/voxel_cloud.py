"""A point cloud that keeps one averaged point per voxel and grows without copying what it has."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import open3d as o3d
from open3d.t.geometry import PointCloud

# Attributes that say how a point was measured and not what is there; their mean over a voxel means nothing. Nor does
# that of normals, whose sign is arbitrary.
RAY_ATTRIBUTES = frozenset(
    {"time", "t", "timestamp", "time_stamp", "col_t", "ring", "column", "col", "channel", "normals"}
)
# A voxel's three indices are packed in 63 bits.
_BITS = 21
_HALF = 1 << (_BITS - 1)


@dataclass(frozen=True, eq=False)
class _Run:
    """Voxels sorted by key. A row of `sums` is count, x, y, z and for each layer its weight and its sum."""

    keys: np.ndarray
    sums: np.ndarray
    layers: tuple[tuple[str, int], ...]


class VoxelCloud:
    """Mean position, mean of every attribute and number of points for each occupied voxel of a grid.

    Read-only: `insert` returns a new cloud that shares what did not change, so a copy costs nothing. Inside are sorted
    runs of voxels, each more than twice as long as the next (a log-structured merge tree): a voxel is moved a
    logarithmic number of times however many clouds are inserted, and no insertion touches the whole unless it is due.

    Attributes of all types become float32 means over the points that have them (NaN counts as not having it), and
    NaN where no point of the voxel has them. `RAY_ATTRIBUTES` are left out. A `count` attribute of an inserted
    cloud is its number of points, so a cloud of means can be inserted again and keeps its weight.
    """

    def __init__(self, voxel: float):
        """Makes an empty cloud of voxels with edge length `voxel` [m]."""
        self.voxel = voxel
        self._runs: tuple[_Run, ...] = ()

    def __deepcopy__(self, memo: dict) -> "VoxelCloud":
        return self

    def insert(self, cloud: PointCloud, X: np.ndarray | None = None) -> "VoxelCloud":
        """Returns this with `cloud` added, each point p taken to X p first where the (4, 4) pose X is given.

        Points that are not finite or more than 2^20 voxels from the origin are left out.
        """
        run = _run_from_cloud(cloud, self.voxel, X)
        grown = VoxelCloud(self.voxel)
        if len(run.keys) == 0:
            grown._runs = self._runs
            return grown
        runs = list(self._runs)
        while runs and len(runs[-1].keys) <= 2 * len(run.keys):
            run = _merge([runs.pop(), run])
        grown._runs = (*runs, run)
        return grown

    def to_cloud(self) -> PointCloud:
        """The means as a cloud: positions float32, attributes float32, and `count` int32, sorted by voxel."""
        if not self._runs:
            return PointCloud(o3d.core.Tensor(np.zeros((0, 3), np.float32)))
        run = _merge(self._runs)
        count = run.sums[:, :1]
        cloud = PointCloud(o3d.core.Tensor((run.sums[:, 1:4] / count).astype(np.float32)))
        column = 4
        for name, width in run.layers:
            weight = run.sums[:, column : column + 1]
            total = run.sums[:, column + 1 : column + 1 + width]
            mean = np.divide(total, weight, out=np.full(total.shape, np.nan), where=weight > 0)
            cloud.point[name] = o3d.core.Tensor(np.ascontiguousarray(mean, np.float32))
            column += 1 + width
        cloud.point["count"] = o3d.core.Tensor(np.ascontiguousarray(count, np.int32))
        return cloud


def voxel_filter(cloud: PointCloud, voxel: float) -> PointCloud:
    """One mean point a voxel [m], with the attributes of `VoxelCloud.to_cloud`."""
    return VoxelCloud(voxel).insert(cloud).to_cloud()


def transform_points(X: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (N, 3) taken through the pose X (4, 4)."""
    return points @ X[:3, :3].T + X[:3, 3]


def _run_from_cloud(cloud: PointCloud, voxel: float, X: np.ndarray | None) -> _Run:
    points = cloud.point.positions.numpy().astype(float)
    if X is not None:
        points = transform_points(X, points)
    with np.errstate(invalid="ignore"):
        inside = (np.abs(points) < _HALF * voxel).all(axis=1)  # False for NaN
    weight = cloud.point["count"].numpy()[:, :1].astype(float) if "count" in cloud.point else np.ones((len(points), 1))
    columns, layers = [weight, points * weight], []
    for name in sorted(name for name, _ in cloud.point.items()):
        if name in RAY_ATTRIBUTES or name in ("positions", "count"):
            continue
        values = cloud.point[name].numpy().astype(float)
        values = values.reshape(len(points), math.prod(values.shape[1:]))  # -1 fails without points
        known = weight * np.isfinite(values).all(axis=1, keepdims=True)
        columns += [known, np.where(known > 0, values, 0.0) * known]
        layers.append((name, values.shape[1]))
    indices = np.floor(points[inside] / voxel).astype(np.int64) + _HALF
    keys = (indices[:, 0] << 2 * _BITS) | (indices[:, 1] << _BITS) | indices[:, 2]
    return _sum_by_key(keys, np.hstack(columns)[inside], tuple(layers))


def _merge(runs: Iterable[_Run]) -> _Run:
    runs = tuple(runs)
    if len(runs) == 1:
        return runs[0]
    layers = tuple(sorted({layer for run in runs for layer in run.layers}))
    sums = np.vstack([_with_layers(run, layers) for run in runs])
    return _sum_by_key(np.concatenate([run.keys for run in runs]), sums, layers)


def _with_layers(run: _Run, layers: tuple[tuple[str, int], ...]) -> np.ndarray:
    if run.layers == layers:
        return run.sums
    starts, column = {}, 4
    for layer in run.layers:
        starts[layer] = column
        column += 1 + layer[1]
    parts = [run.sums[:, :4]]
    for layer in layers:
        width = 1 + layer[1]
        start = starts.get(layer)
        parts.append(np.zeros((len(run.keys), width)) if start is None else run.sums[:, start : start + width])
    return np.hstack(parts)


def _sum_by_key(keys: np.ndarray, sums: np.ndarray, layers: tuple[tuple[str, int], ...]) -> _Run:
    if len(keys) == 0:
        return _Run(keys, sums, layers)
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    starts = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
    return _Run(keys[starts], np.add.reduceat(sums[order], starts, axis=0), layers)
