"""Where cameras sit: extrinsics from correspondences, or from the edges that a depth camera and they both see."""

from .calibration import calibrate_from_correspondences
from .edge_calibration import CalibrationView, EdgeCalibrationConfig, calibrate_from_views
from .extrinsic_calibrator import ExtrinsicCalibrator, ExtrinsicCalibratorConfig
from .pose_fit import Calibration

__all__ = [
    "Calibration",
    "CalibrationView",
    "EdgeCalibrationConfig",
    "ExtrinsicCalibrator",
    "ExtrinsicCalibratorConfig",
    "calibrate_from_correspondences",
    "calibrate_from_views",
]
