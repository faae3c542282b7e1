"""Writes the URDF file of the illuminance robot from its dimensions: `python -m naraha.models.lux_robot.urdf`.

The robot of S4-g: two driven wheels and a caster, a 2D laser of 270° and 30 m, and an illuminance meter on a mast. The
source gives no dimensions; all are assumed. Wheels, gauge and their control are those of the Pioneer 3-DX. Links:
`base` (origin in the middle of the axle, x forward, y left, z up), `left_wheel` and `right_wheel` on the joints
`{left,right}_wheel_joint` (a positive speed drives forward), `imu`, `lidar` (level, its origin the scan centre), and
`mast`, which carries the frame `meter`: the middle of the meter's plate, z its normal.

The body is round about the axle, so that turning on the spot needs no room. Contact of a wheel is a sphere, for the
reasons that `naraha.models.pioneer.urdf` gives; with it the robot is 2 x 0.263 m wide.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from naraha.systems.config import check_config, quantity

from ..drive_wheel import add_drive_wheel
from ..urdf_xml import (
    Colour,
    add_collision,
    add_frame,
    add_joint,
    add_link,
    add_visual,
    box,
    cylinder,
    sphere,
    urdf_text,
)
from ..utm30lx import CENTRE, HEIGHT, MASS, WIDTH

_BLUE: Colour = (0.1, 0.25, 0.5)
_RUBBER: Colour = (0.085, 0.085, 0.095)
_STEEL: Colour = (0.6, 0.61, 0.63)
_DARK: Colour = (0.12, 0.12, 0.13)
_WHITE: Colour = (0.93, 0.93, 0.9)


@dataclass(kw_only=True)
class LuxRobotShape:
    """Dimensions, masses, friction and motors. Lengths in [m], masses in [kg]."""

    wheel_radius: float = quantity(0.0975, unit="m", above=0.0)
    wheel_width: float = quantity(0.05, unit="m", above=0.0)
    # [m] distance of the wheels' middle planes.
    gauge: float = quantity(0.331, unit="m", above=0.0)
    # [m] the round body: its radius, its bottom and its top over ground.
    radius: float = quantity(0.25, unit="m", above=0.0)
    clearance: float = quantity(0.05, unit="m", above=0.0)
    top: float = quantity(0.28, unit="m", above=0.0)
    # [m] caster: how far behind the axle it stands, and its radius.
    caster_distance: float = quantity(0.19, unit="m", above=0.0)
    caster_radius: float = quantity(0.03, unit="m", above=0.0)
    # [m] scan centre of the laser before the axle; it stands on the body.
    laser_x: float = quantity(0.12, unit="m")
    # [m] mast over the axle, so that the meter is where the robot is; it is behind the laser, out of its field. Height
    # of the meter's plate over ground: where the top of a desk is.
    mast_x: float = quantity(0.0, unit="m")
    meter_height: float = quantity(0.85, unit="m", above=0.0)

    base_mass: float = quantity(9.5, unit="kg", above=0.0)
    wheel_mass: float = quantity(0.5, unit="kg", above=0.0)
    imu_mass: float = quantity(0.05, unit="kg", above=0.0)
    mast_mass: float = quantity(0.5, unit="kg", above=0.0)
    # [m] centre of mass of the base behind the axle and over ground: on the caster's side, so that it never nods.
    base_mass_x: float = quantity(-0.05, unit="m")
    base_mass_height: float = quantity(0.13, unit="m", above=0.0)

    tyre_friction: float = quantity(0.7, low=0.0)
    caster_friction: float = quantity(0.02, low=0.0)
    body_friction: float = quantity(0.3, low=0.0)

    # [N m] torque of a wheel.
    wheel_effort: float = quantity(2.0, unit="N m", above=0.0)
    # [N m/rad], [N m s/rad] control of a wheel, critically damped with its half of the robot (0.054 kg m²).
    wheel_p: float = quantity(60.0, unit="N m/rad", above=0.0)
    wheel_d: float = quantity(3.6, unit="N m s/rad", above=0.0)


def lux_robot_urdf(shape: LuxRobotShape) -> str:
    """The URDF of a robot of this shape. Raises `ConfigError` when a dimension is out of range."""
    check_config(shape)
    robot = ElementTree.Element("robot", {"name": "lux_robot", "xmlns:drake": "http://drake.mit.edu"})
    _add_base(robot, shape)
    for side, sign in (("left", 1), ("right", -1)):
        _add_wheel(robot, shape, f"{side}_wheel", sign * shape.gauge / 2)
    add_link(robot, "imu", shape.imu_mass, (0.04, 0.04, 0.02))
    add_joint(robot, "imu_weld", "fixed", "imu", (0, 0, 0))
    _add_laser(robot, shape)
    _add_mast(robot, shape)
    return urdf_text(robot, "naraha.models.lux_robot.urdf")


def main() -> None:
    """Rewrites the shipped file, beside this one."""
    (Path(__file__).parent / "lux_robot.urdf").write_text(lux_robot_urdf(LuxRobotShape()), encoding="utf-8")


def _add_base(robot: ElementTree.Element, shape: LuxRobotShape) -> None:
    r, height = shape.wheel_radius, shape.top - shape.clearance
    middle = (0.0, 0.0, (shape.top + shape.clearance) / 2 - r)
    size = (2 * shape.radius, 2 * shape.radius, height)
    base = add_link(robot, "base", shape.base_mass, size, (shape.base_mass_x, 0, shape.base_mass_height - r))
    add_collision(base, shape.body_friction, middle, cylinder(shape.radius, height))
    caster = (-shape.caster_distance, 0.0, shape.caster_radius - r)
    add_collision(base, shape.caster_friction, caster, sphere(shape.caster_radius))
    plate = 0.012
    inner = shape.gauge / 2 - shape.wheel_width / 2 - 0.005
    add_visual(base, _BLUE, (0, 0, shape.top - 0.06 - r), cylinder(shape.radius, 0.12 - plate))
    add_visual(base, _DARK, (0, 0, middle[2]), box(1.7 * shape.radius, 2 * inner, height - 2 * plate))
    add_visual(base, _DARK, (0, 0, shape.top - plate / 2 - r), cylinder(shape.radius, plate))
    add_visual(base, _STEEL, (-shape.caster_distance, 0, shape.clearance - r), cylinder(0.02, 0.02))
    add_visual(base, _RUBBER, caster, cylinder(shape.caster_radius, 0.025), (math.pi / 2, 0.0, 0.0))


def _add_wheel(robot: ElementTree.Element, shape: LuxRobotShape, name: str, y: float) -> None:
    add_drive_wheel(
        robot,
        name,
        y,
        radius=shape.wheel_radius,
        width=shape.wheel_width,
        mass=shape.wheel_mass,
        friction=shape.tyre_friction,
        effort=shape.wheel_effort,
        p=shape.wheel_p,
        d=shape.wheel_d,
        colours=(_RUBBER, _STEEL, _BLUE),
    )


def _add_laser(robot: ElementTree.Element, shape: LuxRobotShape) -> None:
    middle = HEIGHT / 2 - CENTRE
    lidar = add_link(robot, "lidar", MASS, (WIDTH, WIDTH, HEIGHT), (0, 0, middle))
    add_collision(lidar, shape.body_friction, (0, 0, middle), box(WIDTH, WIDTH, HEIGHT))
    add_visual(lidar, _DARK, (0, 0, -CENTRE + 0.02), box(WIDTH, WIDTH, 0.04))
    add_visual(lidar, _DARK, (0, 0, -0.005), cylinder(0.026, 0.04))
    add_visual(lidar, _STEEL, (0, 0, HEIGHT - CENTRE - 0.008), cylinder(0.029, 0.016))
    place = (shape.laser_x, 0.0, shape.top - shape.wheel_radius + CENTRE)
    add_joint(robot, "lidar_weld", "fixed", "lidar", place)


def _add_mast(robot: ElementTree.Element, shape: LuxRobotShape) -> None:
    r, length, plate = shape.wheel_radius, shape.meter_height - shape.top, 0.03
    mast = add_link(robot, "mast", shape.mast_mass, (0.04, 0.04, length), (0, 0, length / 2))
    add_collision(mast, shape.body_friction, (0, 0, length / 2), box(0.04, 0.04, length))
    pole = length - plate
    add_visual(mast, _STEEL, (0, 0, pole / 2), cylinder(0.015, pole))
    add_visual(mast, _WHITE, (0, 0, length - plate / 2), cylinder(0.04, plate))
    add_joint(robot, "mast_weld", "fixed", "mast", (shape.mast_x, 0.0, shape.top - r))
    add_frame(robot, "meter", "mast", (0, 0, length))


if __name__ == "__main__":
    main()
