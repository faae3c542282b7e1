"""How far dead reckoning can be trusted over a step."""

from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform

from ..config import quantity
from .motion import distance_and_angle


@dataclass(kw_only=True)
class OdometryAccuracy:
    """Standard deviations of a step of odometry: tracks slip, and an IMU knows the vertical."""

    # [-] Of the shift as part of the way, and of the yaw as part of the turn.
    slip: float = quantity(0.2, unit="m/m", above=0)
    yaw_slip: float = quantity(0.1, unit="rad/rad", above=0)
    # [deg/m] What yaw drifts on straight ways.
    yaw_drift_deg: float = quantity(2.0, unit="deg/m", above=0)
    # [deg] Of roll and pitch, by the IMU.
    tilt_deviation_deg: float = quantity(0.5, unit="deg", above=0)
    # [m], [deg] Of a step that goes nowhere.
    least_deviation: float = quantity(0.01, unit="m", above=0)
    least_deviation_deg: float = quantity(0.1, unit="deg", above=0)


def odometry_covariance(step: RigidTransform, accuracy: OdometryAccuracy) -> np.ndarray:
    """Covariance of a step of odometry in the axes of its end, (6, 6), roll, pitch, yaw, x, y, z [rad, m]."""
    distance, angle = distance_and_angle(step)
    yaw = np.hypot(accuracy.yaw_slip * angle, np.deg2rad(accuracy.yaw_drift_deg) * distance)
    yaw = np.hypot(yaw, np.deg2rad(accuracy.least_deviation_deg))
    tilt = np.deg2rad(accuracy.tilt_deviation_deg)
    shift = np.hypot(accuracy.slip * distance, accuracy.least_deviation)
    return np.diag(np.square([tilt, tilt, yaw, shift, shift, shift]))
