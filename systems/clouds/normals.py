"""Normals of any point cloud, from its neighbours."""

import numpy as np
import open3d as o3d

# Neighbours make a plane if the variance across it is this small against the one along its narrower side, and that
# against the one along its wider side is not as small as on a line.
FLAT, LINE = 0.05, 0.05


def estimate_normals(points: np.ndarray, radius: float) -> np.ndarray:
    """Unit normals (N, 3) of `points` (N, 3) from up to 20 neighbours within `radius` [m]; their sign is arbitrary.

    They are zero where the neighbours do not make a plane: at edges and corners, and on the single line that one ring
    of a LiDAR leaves far away. Normals there point anywhere, and with the mean points of voxels at the foot of a wall
    they lift the robot where no ceiling holds it down.
    """
    legacy = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(float)))
    legacy.estimate_covariances(o3d.geometry.KDTreeSearchParamHybrid(radius, 20))
    spread, axes = np.linalg.eigh(np.asarray(legacy.covariances).reshape(-1, 3, 3))
    planar = (spread[:, 0] < FLAT * spread[:, 1]) & (spread[:, 1] > LINE * spread[:, 2])
    return np.where(planar[:, None], axes[:, :, 0], 0.0)
