"""Where the robot is and what is around it: odometry, scan matching, the survey map, and how good they are."""

from .constraint import constraint, undo_unheld_motion
from .evaluation import map_error, rebuild_map, trajectory_error
from .keyframe import Keyframe, PoseHealth
from .odometry import Odometry6Dof, OdometryConfig, propagate, rotation
from .registration import Registration, RegistrationConfig, estimate_normals, register
from .scan_matcher import ScanMatcher
from .scan_tracking import ScanMatcherConfig, Track, track_scan
from .survey_map import SurveyMap, SurveyMapConfig
from .voxel_cloud import VoxelCloud, voxel_filter

__all__ = [
    "Keyframe",
    "Odometry6Dof",
    "OdometryConfig",
    "PoseHealth",
    "Registration",
    "RegistrationConfig",
    "ScanMatcher",
    "ScanMatcherConfig",
    "SurveyMap",
    "SurveyMapConfig",
    "Track",
    "VoxelCloud",
    "constraint",
    "estimate_normals",
    "map_error",
    "propagate",
    "rebuild_map",
    "register",
    "rotation",
    "track_scan",
    "trajectory_error",
    "undo_unheld_motion",
    "voxel_filter",
]
