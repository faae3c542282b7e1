"""What a snake can measure that tells whether it is stuck, where, and how (row S1-g)."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class SnakeMeasures:
    """The measures of a snake that its own measurements are read with.

    Attributes:
        units: n.
        half_length: from a pitch joint to the next yaw joint [m].
        wheel_radius: [m].
        clearance: of the belly over flat ground [m].
        wheel_side: from the side of the body to the outer face of a wheel [m].
        weight: of the robot [N].
    """

    units: int
    half_length: float
    wheel_radius: float
    clearance: float
    wheel_side: float
    weight: float


@dataclass(frozen=True, eq=False)
class StuckFeatures:
    """Measurements in the form that the rules of `stuck_rules` read.

    Attributes:
        wheel_speed: mean speed of the rims, positive ahead [m/s].
        command_speed: mean of what they are commanded [m/s].
        body_speed: of the head along its x axis, from the IMU [m/s].
        thrust: force of all wheels at their rims, positive ahead [N].
        belly_loads: (2n,) forces of the belly pads, half by half from the head [N].
        yaw_torques: (n - 1,) [N m].
        axle_heights: (n,) of the axles above the first one, z up by gravity [m].
        under: (2n,) nearest thing below each half of the belly [m].
        beside: (2, 2n) nearest thing to the left and to the right of each half [m].
    """

    wheel_speed: float
    command_speed: float
    body_speed: float
    thrust: float
    belly_loads: np.ndarray
    yaw_torques: np.ndarray
    axle_heights: np.ndarray
    under: np.ndarray
    beside: np.ndarray
