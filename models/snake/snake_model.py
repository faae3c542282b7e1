"""Dimensions of the snake and what follows from them."""

import math
from dataclasses import dataclass

from naraha.systems.config import check_config, quantity

HALF_LENGTHS = (0.080, 0.085, 0.090, 0.095, 0.100)
"""Lengths [m] of half a unit, from a pitch joint to the next yaw joint, in the five steps of the link. Assumed."""

YAW_RANGES = tuple(math.radians(angle) for angle in (60.0, 67.5, 75.0, 82.5, 90.0))
"""Largest yaw angles [rad] of the five steps: 60° with the shortest link, 90° with the longest (S1)."""


@dataclass(kw_only=True)
class SnakeModel:
    """The articulated robot of S1. Its dimensions are not published: all values here are assumed.

    A unit has a front half F_i, a pitch joint p_i with a pair of driven wheels on its axis, and a rear half R_i. Yaw
    joint y_i joins R_i and F_{i+1}. Units are counted from the head, from 0 to units - 1.
    """

    # Pitch joints, each with its pair of wheels; one yaw joint fewer.
    units: int = quantity(10, low=2, high=99)
    # Which of the five lengths the links are set to, 0 the shortest.
    length_step: int = quantity(2, low=0, high=4)
    # [m] wheels: radius, width, distance of the two of a pair.
    wheel_radius: float = quantity(0.05, unit="m", above=0.0)
    wheel_width: float = quantity(0.024, unit="m", above=0.0)
    tread: float = quantity(0.16, unit="m", above=0.0)
    # [m] depth of the flat belly under the joint axes; with the wheels it leaves 35 mm of clearance.
    belly_depth: float = quantity(0.015, unit="m", above=0.0)
    # [m] half of the width of the body.
    half_width: float = quantity(0.055, unit="m", above=0.0)
    # [m] how far a yaw actuator stands above the joint axes. It keeps the belly flat; moving a joint along its own
    # axis does not change its motion, so that the joint's frame stays at the height of the others.
    yaw_offset: float = quantity(0.03, unit="m", low=0.0)
    # [kg] half a unit, a wheel: 9.5 kg for ten units.
    half_mass: float = quantity(0.355, unit="kg", above=0.0)
    wheel_mass: float = quantity(0.12, unit="kg", above=0.0)

    # [rad] range of the pitch joints.
    pitch_range: float = quantity(math.pi / 2, unit="rad", above=0.0, high=math.pi / 2)
    # [N m], [rad/s] largest torque and speed of a pitch or yaw joint.
    joint_torque: float = quantity(15.0, unit="N m", above=0.0)
    joint_speed: float = quantity(6.0, unit="rad/s", above=0.0)
    # [N m] largest torque of a wheel, for seconds. The driver keeps to what it gives for ever.
    wheel_torque: float = quantity(1.0, unit="N m", above=0.0)
    # [N m/rad], [N m s/rad] position control of the joints.
    joint_p: float = quantity(300.0, unit="N m/rad", above=0.0)
    joint_d: float = quantity(6.0, unit="N m s/rad", above=0.0)
    # [N m/rad], [N m s/rad] control of a wheel's angle: a wheel at rest gives way by 0.5 mm before it slips.
    wheel_p: float = quantity(30.0, unit="N m/rad", above=0.0)
    wheel_d: float = quantity(1.0, unit="N m s/rad", above=0.0)

    # Friction of tyres and of belly and sides. Drake combines two surfaces as 2 m n / (m + n).
    wheel_friction: float = quantity(0.8, low=0.0)
    pad_friction: float = quantity(0.6, low=0.0)

    def __post_init__(self) -> None:
        check_config(self, key="snake")

    @property
    def half_length(self) -> float:
        """Length [m] of half a unit, from a pitch joint to the next yaw joint."""
        return HALF_LENGTHS[self.length_step]

    @property
    def yaw_range(self) -> float:
        """Largest yaw angle [rad]."""
        return YAW_RANGES[self.length_step]

    @property
    def length(self) -> float:
        """From nose to tail, stretched out [m]."""
        return 2 * self.units * self.half_length

    @property
    def mass(self) -> float:
        """Of the whole robot with its IMU [kg]."""
        return 2 * self.units * (self.half_mass + self.wheel_mass) + IMU_MASS

    def joint_names(self) -> list[str]:
        """p0, y0, p1, y1, ..., the order of every vector of joint quantities: 2 units - 1, from head to tail."""
        return [f"{kind}{i}" for i in range(self.units) for kind in "py"][:-1]

    def wheel_names(self) -> list[str]:
        """w0L, w0R, w1L, ..., the order of every vector of wheel quantities: 2 units."""
        return [f"w{i}{side}" for i in range(self.units) for side in "LR"]

    def joint_limits(self) -> list[float]:
        """Ranges [rad], the same to both sides, in the order of `joint_names`."""
        return [self.pitch_range if name.startswith("p") else self.yaw_range for name in self.joint_names()]


IMU_MASS = 0.02
"""[kg]"""
