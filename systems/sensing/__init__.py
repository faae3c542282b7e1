"""Simulated sensors on SceneGraph geometry, and readers of recorded scans."""

from .body_pose import BodyPose
from .deskew import deskew, interpolate_pose
from .imu import Imu, ImuConfig
from .lidar import Lidar, LidarConfig
from .ray_scene import RayHits, RayScene, welded_frames
from .scan import PointCloud, Scan
from .scan_pattern import ScanPattern, utm30lx, vlp16
from .surfaces import Surface, SurfaceTable
from .track_encoders import TrackEncoders, TrackEncodersConfig

__all__ = [
    "BodyPose",
    "Imu",
    "ImuConfig",
    "Lidar",
    "LidarConfig",
    "PointCloud",
    "RayHits",
    "RayScene",
    "Scan",
    "ScanPattern",
    "Surface",
    "SurfaceTable",
    "TrackEncoders",
    "TrackEncodersConfig",
    "deskew",
    "interpolate_pose",
    "utm30lx",
    "vlp16",
    "welded_frames",
]
