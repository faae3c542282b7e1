"""The voxel map: free and occupied space, classes and channel means, sub-maps that move with the pose graph."""

from .dense_voxels import FREE, NO_LABEL, OCCUPIED, UNKNOWN, DenseVoxels
from .occupancy_map import OccupancyMap, OccupancyMapConfig
from .octomap_files import MapFileError, read_octomap, write_octomap
from .submaps import Submap, SubmapCollection, SubmapConfig
from .voxel_map import CHANNELS, VoxelMap
from .voxel_map_config import VoxelMapConfig
from .voxel_view import VoxelView

__all__ = [
    "CHANNELS",
    "FREE",
    "NO_LABEL",
    "OCCUPIED",
    "UNKNOWN",
    "DenseVoxels",
    "MapFileError",
    "OccupancyMap",
    "OccupancyMapConfig",
    "Submap",
    "SubmapCollection",
    "SubmapConfig",
    "VoxelMap",
    "VoxelMapConfig",
    "VoxelView",
    "read_octomap",
    "write_octomap",
]
