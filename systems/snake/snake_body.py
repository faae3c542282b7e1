"""What the controllers know of the robot."""

from dataclasses import dataclass

import numpy as np

from ..errors import ConfigError


@dataclass(frozen=True, eq=False)
class SnakeBody:
    """Dimensions of a snake.

    Attributes:
        half_length: of a unit, from a pitch joint to the next yaw joint [m].
        wheel_radius, tread: of the wheels and between the two of a pair [m].
        joint_limits: (2n - 1,) ranges [rad], the same to both sides, p0, y0, p1, ... from the head.
    """

    half_length: float
    wheel_radius: float
    tread: float
    joint_limits: np.ndarray

    def __post_init__(self) -> None:
        for name in ("half_length", "wheel_radius", "tread"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ConfigError("out of range", key=name, value=value, valid="> 0 m")
        limits = np.asarray(self.joint_limits, dtype=float)
        if limits.ndim != 1 or len(limits) < 3 or len(limits) % 2 == 0 or not (limits > 0).all():
            valid = "2n - 1 ranges above 0, n >= 2"
            raise ConfigError("not the ranges of a snake's joints", key="joint_limits", value=limits.shape, valid=valid)
        object.__setattr__(self, "joint_limits", limits)

    @property
    def units(self) -> int:
        """Number of pitch joints."""
        return (len(self.joint_limits) + 1) // 2
