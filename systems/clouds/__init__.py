"""What every user of point clouds shares: thinning, averaging, moving, normals, and the ground around a robot."""

from .local_cloud import LocalCloud
from .local_points import LocalCloudConfig, heading_frame
from .normals import estimate_normals
from .voxel_cloud import RAY_ATTRIBUTES, VoxelCloud, transform_points, voxel_filter

__all__ = [
    "RAY_ATTRIBUTES",
    "LocalCloud",
    "LocalCloudConfig",
    "VoxelCloud",
    "estimate_normals",
    "heading_frame",
    "transform_points",
    "voxel_filter",
]
