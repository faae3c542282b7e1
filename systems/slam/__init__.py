"""Where the robot is and what is around it: odometry, scan matching, the survey map, and how good they are."""

from .evaluation import map_error, rebuild_map, trajectory_error
from .keyframe import Keyframe, KeyframePoses, PoseHealth
from .odometry import Odometry6Dof, OdometryConfig, propagate, rotation
from .odometry_accuracy import OdometryAccuracy, odometry_covariance
from .scan_matcher import ScanMatcher
from .scan_tracking import ScanMatcherConfig, Track, track_scan
from .survey_map import SurveyMap, SurveyMapConfig

__all__ = [
    "Keyframe",
    "KeyframePoses",
    "Odometry6Dof",
    "OdometryAccuracy",
    "OdometryConfig",
    "PoseHealth",
    "ScanMatcher",
    "ScanMatcherConfig",
    "SurveyMap",
    "SurveyMapConfig",
    "Track",
    "map_error",
    "odometry_covariance",
    "propagate",
    "rebuild_map",
    "rotation",
    "track_scan",
    "trajectory_error",
]
