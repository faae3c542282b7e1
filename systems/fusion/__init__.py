"""What cameras saw, on the cloud: any camera onto any cloud, by way of a pan-tilt if it rides on one (S0-a, S0-b)."""

from .camera_fusion import CameraFusion, CameraFusionConfig, FusionHealth
from .camera_view import CameraView, LampConfig
from .keyframe_assembler import KeyframeAssembler, KeyframeAssemblerConfig
from .painting import Paint, PaintConfig, paint
from .projection import check_extrinsics, project
from .sweep import PanTiltSweep, SweepConfig, plan_sweep, seam_error
from .visibility import VisibilityConfig, visible

__all__ = [
    "CameraFusion",
    "CameraFusionConfig",
    "CameraView",
    "FusionHealth",
    "KeyframeAssembler",
    "KeyframeAssemblerConfig",
    "LampConfig",
    "Paint",
    "PaintConfig",
    "PanTiltSweep",
    "SweepConfig",
    "VisibilityConfig",
    "check_extrinsics",
    "paint",
    "plan_sweep",
    "project",
    "seam_error",
    "visible",
]
