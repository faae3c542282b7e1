"""Where the robot is and what is around it: odometry, scan matching, the survey map, and how good they are."""

from .keyframe import Keyframe, PoseHealth
from .registration import Registration, RegistrationConfig, constraint, estimate_normals, register
from .scan_tracking import ScanMatcherConfig, Track, track_scan
from .voxel_cloud import VoxelCloud, voxel_filter

__all__ = [
    "Keyframe",
    "PoseHealth",
    "Registration",
    "RegistrationConfig",
    "ScanMatcherConfig",
    "Track",
    "VoxelCloud",
    "constraint",
    "estimate_normals",
    "register",
    "track_scan",
    "voxel_filter",
]
