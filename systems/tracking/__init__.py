"""Following a path: waypoint tours and Kanayama's tracking law."""

from .kanayama import KanayamaConfig, KanayamaTracking, kanayama_law, planar_pose, pose_error
from .path import Path
from .path_follower import PathFollower, PathFollowerConfig
from .waypoint_tour import TourConfig, Waypoint, WaypointTour, leg_reference

__all__ = [
    "KanayamaConfig",
    "KanayamaTracking",
    "Path",
    "PathFollower",
    "PathFollowerConfig",
    "TourConfig",
    "Waypoint",
    "WaypointTour",
    "kanayama_law",
    "leg_reference",
    "planar_pose",
    "pose_error",
]
