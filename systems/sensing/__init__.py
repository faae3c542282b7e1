"""Simulated sensors on SceneGraph geometry, and readers of recorded scans."""

from .body_pose import BodyPose
from .deskew import deskew, interpolate_pose
from .imu import Imu, ImuConfig
from .lidar import Lidar, LidarConfig
from .pose_files import Poses, associate, read_poses, write_tum
from .ray_scene import RayHits, RayScene, welded_frames
from .scan import PointCloud, Scan
from .scan_files import list_scans, read_scan, write_cloud
from .scan_pattern import ScanPattern, utm30lx, vlp16
from .scan_replay import ScanReplay, timed_scan
from .surfaces import Surface, SurfaceTable
from .track_encoders import TrackEncoders, TrackEncodersConfig

__all__ = [
    "BodyPose",
    "Imu",
    "ImuConfig",
    "Lidar",
    "LidarConfig",
    "PointCloud",
    "Poses",
    "RayHits",
    "RayScene",
    "Scan",
    "ScanPattern",
    "ScanReplay",
    "Surface",
    "SurfaceTable",
    "TrackEncoders",
    "TrackEncodersConfig",
    "associate",
    "deskew",
    "interpolate_pose",
    "list_scans",
    "read_poses",
    "read_scan",
    "timed_scan",
    "utm30lx",
    "vlp16",
    "welded_frames",
    "write_cloud",
    "write_tum",
]
