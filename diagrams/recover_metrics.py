"""What is measured of a recovery: numbers of the whole mission, and a row for every moment of an attempt."""

from dataclasses import dataclass

import numpy as np
from naraha.systems.snake.recovery_motion import rotation_by, rotation_vector
from naraha.systems.snake.recovery_state import RecoveryStatus


@dataclass
class RecoverMetrics:
    """What is measured of a mission; the names are those of `metrics.json`.

    `head_motion_m` is the farthest that the head got from its place during the last attempt, `control_point_error_m`
    that at the end of its recovery.
    """

    stuck_advance_m: float = np.nan
    detected: bool = False
    detected_class: int = 0
    detected_unit: int = -1
    detection_confidence: float = 0.0
    true_class: int = 0
    true_unit: int = -1
    freed: bool = False
    attempts: int = 0
    move: str = ""
    rehearsal_faithful: bool = True
    head_motion_m: float = np.nan
    control_point_error_m: float = np.nan
    control_point_error_max_m: float = np.nan
    target_distance_start_m: float = np.nan
    target_distance_end_m: float = np.nan
    min_limit_margin_rad: float = np.inf
    min_tip_margin_m: float = np.inf
    max_tilt_rad: float = 0.0
    advance_after_m: float = 0.0


COLUMNS = (
    "time_s",
    *(
        f"{what}_{axis}"
        for what in ("reference", "control", "error")
        for axis in ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
    ),
    "target_distance_m",
    "manipulability_m3",
    "limit_margin_rad",
    "tip_margin_m",
    "head_motion_m",
)
"""What a row of `RecoverScript.rows` holds."""


def control_pose(status: RecoveryStatus) -> tuple[np.ndarray, np.ndarray]:
    """w_e and w_ref (6,) in the frame A of the segment: position [m] and rotation vector [rad]; NaN before a motion."""
    R_ref = status.reference[3:].reshape(3, 3)
    if not np.isfinite(R_ref).all():
        return np.full(6, np.nan), np.full(6, np.nan)
    R = rotation_by(status.control_error[3:]) @ R_ref
    position = status.reference[:3] + status.control_error[:3]
    return np.r_[position, rotation_vector(R)], np.r_[status.reference[:3], rotation_vector(R_ref)]
