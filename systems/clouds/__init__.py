"""What every user of point clouds shares: thinning, averaging, moving, normals."""

from .normals import estimate_normals
from .voxel_cloud import RAY_ATTRIBUTES, VoxelCloud, transform_points, voxel_filter

__all__ = ["RAY_ATTRIBUTES", "VoxelCloud", "estimate_normals", "transform_points", "voxel_filter"]
