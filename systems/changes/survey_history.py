"""Two survey maps in one, in which every point keeps where and when it was seen."""

from collections.abc import Sequence

import numpy as np
import open3d as o3d
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform

from ..clouds import VoxelCloud, transform_points
from ..slam.keyframe import Keyframe
from .seen_space import voxel_keys
from .survey_changes import UNCHANGED, VANISHED

# What the updated map says of every point, with the value of a point of which it is not known.
HISTORY = {"change": 0, "survey": 0, "first_survey": 0, "first_seen": np.nan, "last_seen": np.nan}
_KINDS = {"change": np.uint8, "survey": np.uint16, "first_survey": np.uint16}


def map_of(keyframes: Sequence[Keyframe], X_MK: RigidTransform, voxel_size: float) -> PointCloud:
    voxels = VoxelCloud(voxel_size)
    for keyframe in keyframes:
        voxels = voxels.insert(keyframe.cloud_B, (X_MK @ keyframe.X_MB).GetAsMatrix4())
    return voxels.to_cloud()


def times_seen(keyframes: Sequence[Keyframe], X_MK: RigidTransform, voxel_size: float) -> tuple[np.ndarray, np.ndarray]:
    """When every point of `map_of` was seen first and last, (N,) each [s]; its points are in the order of the keys."""
    keys, times = [], []
    for keyframe in keyframes:
        p_MP = transform_points((X_MK @ keyframe.X_MB).GetAsMatrix4(), keyframe.p_BP.astype(float))
        keys.append(np.unique(voxel_keys(p_MP, voxel_size)))
        times.append(np.full(len(keys[-1]), keyframe.time))
    every, time = np.concatenate(keys), np.concatenate(times)
    usable = every >= 0
    every, time = every[usable], time[usable]
    order = np.lexsort((time, every))
    every, time = every[order], time[order]
    starts = np.flatnonzero(np.concatenate([[True], every[1:] != every[:-1]]))
    return time[starts], time[np.append(starts[1:], len(every)) - 1]


def history_of(map_M: PointCloud) -> dict[str, np.ndarray]:
    """What the map says of its points' history, (N,) each."""
    count = len(map_M.point.positions)
    columns = {}
    for name, unknown in HISTORY.items():
        values = map_M.point[name].numpy().ravel() if name in map_M.point else np.full(count, unknown)
        columns[name] = values.astype(_KINDS.get(name, np.float32))
    return columns


def attach_history(cloud: PointCloud, history: dict[str, np.ndarray]) -> None:
    for name, values in history.items():
        column = values.astype(_KINDS.get(name, np.float32))[:, None]
        cloud.point[name] = o3d.core.Tensor(np.ascontiguousarray(column))


def join_maps(
    old_M: PointCloud, old: dict[str, np.ndarray], new_M: PointCloud, new: dict[str, np.ndarray], voxel_size: float
) -> PointCloud:
    """Both maps in one, voxel by voxel, with their histories; what vanished stays beside it as it was."""
    vanished = old["change"] == VANISHED
    bare = old_M.clone()
    for name in HISTORY:
        if name in bare.point:
            del bare.point[name]
    gone = VoxelCloud(voxel_size).insert(bare.select_by_mask(o3d.core.Tensor(vanished)))
    kept = bare.select_by_mask(o3d.core.Tensor(~vanished))
    joined = VoxelCloud(voxel_size).insert(kept).insert(new_M).to_cloud()
    # Rows of `to_cloud` are in the order of the keys.
    kept_rows, new_rows = _rows(kept, new_M, voxel_size=voxel_size)
    history = {}
    for name in HISTORY:
        column = np.zeros(len(joined.point.positions), old[name].dtype)
        column[new_rows] = new[name]
        if name.startswith("first"):
            column[kept_rows] = old[name][~vanished]
        else:
            only_old = ~np.isin(kept_rows, new_rows)
            column[kept_rows[only_old]] = old[name][~vanished][only_old]
        history[name] = column
    both = np.intersect1d(kept_rows, new_rows)
    history["change"][both] = UNCHANGED
    if not vanished.any():
        attach_history(joined, history)
        return joined
    gone_cloud = gone.to_cloud()
    (gone_rows,) = _rows(bare.select_by_mask(o3d.core.Tensor(vanished)), voxel_size=voxel_size)
    for name in HISTORY:
        column = np.zeros(len(gone_cloud.point.positions), old[name].dtype)
        column[gone_rows] = old[name][vanished]
        history[name] = np.concatenate([history[name], column])
    cloud = _stack(joined, gone_cloud)
    attach_history(cloud, history)
    return cloud


def _rows(*clouds: PointCloud, voxel_size: float) -> list[np.ndarray]:
    """The row of each point's voxel in the cloud of all of them together."""
    points = [cloud.point.positions.numpy() for cloud in clouds]
    rows = np.unique(voxel_keys(np.concatenate(points), voxel_size), return_inverse=True)[1].ravel()
    return np.split(rows, np.cumsum([len(p) for p in points])[:-1])


def _stack(first: PointCloud, second: PointCloud) -> PointCloud:
    """Rows of both; an attribute that one of them does not have is NaN there."""
    clouds = (first, second)
    stacked = PointCloud()
    widths = {name: tensor.shape[1] for cloud in clouds for name, tensor in cloud.point.items()}
    for name, width in widths.items():
        parts = []
        for cloud in clouds:
            missing = np.full((len(cloud.point.positions), width), np.nan, np.float32)
            parts.append(cloud.point[name].numpy() if name in cloud.point else missing)
        stacked.point[name] = o3d.core.Tensor(np.ascontiguousarray(np.concatenate(parts)))
    return stacked
