"""Simulated sensors on SceneGraph geometry, and readers of recorded scans."""

from .body_pose import BodyPose
from .camera_model import R_OPTICAL, CameraModel
from .depth_camera import DepthCamera, DepthCameraConfig
from .deskew import deskew, interpolate_pose
from .gamma_counter import DoseReading, GammaCounter, GammaCounterConfig
from .illuminance_field import IlluminanceField, fit_field
from .illuminance_meter import IlluminanceMeter, IlluminanceMeterConfig
from .imu import Imu, ImuConfig
from .lamps import Emitters, Lamp, Window, illuminance, make_emitters
from .lidar import Lidar, LidarConfig, scan_at
from .nir_camera import NirCamera, NirCameraConfig
from .pan_tilt import PanTilt, PanTiltConfig, pan_tilt_pose
from .pose_files import Poses, associate, read_poses, write_tum
from .ray_scene import RayHits, RayScene, welded_frames
from .scan import PointCloud, Scan
from .scan_files import list_scans, read_scan, write_cloud
from .scan_pattern import ScanPattern, utm30lx, utm30lx_10hz, vlp16
from .scan_replay import ScanReplay, timed_scan
from .surfaces import Surface, SurfaceTable
from .thermal_camera import ThermalCamera, ThermalCameraConfig
from .track_encoders import TrackEncoders, TrackEncodersConfig

__all__ = [
    "R_OPTICAL",
    "BodyPose",
    "CameraModel",
    "DepthCamera",
    "DepthCameraConfig",
    "DoseReading",
    "Emitters",
    "GammaCounter",
    "GammaCounterConfig",
    "IlluminanceField",
    "IlluminanceMeter",
    "IlluminanceMeterConfig",
    "Imu",
    "ImuConfig",
    "Lamp",
    "Lidar",
    "LidarConfig",
    "NirCamera",
    "NirCameraConfig",
    "PanTilt",
    "PanTiltConfig",
    "PointCloud",
    "Poses",
    "RayHits",
    "RayScene",
    "Scan",
    "ScanPattern",
    "ScanReplay",
    "Surface",
    "SurfaceTable",
    "ThermalCamera",
    "ThermalCameraConfig",
    "TrackEncoders",
    "TrackEncodersConfig",
    "Window",
    "associate",
    "deskew",
    "fit_field",
    "illuminance",
    "interpolate_pose",
    "list_scans",
    "make_emitters",
    "pan_tilt_pose",
    "read_poses",
    "read_scan",
    "scan_at",
    "timed_scan",
    "utm30lx",
    "utm30lx_10hz",
    "vlp16",
    "welded_frames",
    "write_cloud",
    "write_tum",
]
