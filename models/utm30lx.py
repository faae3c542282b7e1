"""A UTM-30LX on a tilt unit, as a part of a robot."""

import math
from xml.etree import ElementTree

from .urdf_xml import (
    Colour,
    add_actuator,
    add_collision,
    add_frame,
    add_joint,
    add_link,
    add_visual,
    box,
    cylinder,
    numbers,
)

_DARK: Colour = (0.14, 0.15, 0.17)
_STEEL: Colour = (0.45, 0.46, 0.48)
_GLASS: Colour = (0.03, 0.04, 0.08)

WIDTH, HEIGHT, CENTRE, MASS = 0.06, 0.087, 0.0567, 0.21
"""Housing [m], scan centre over its foot [m], and mass without cable [kg] of the UTM-30LX: its data sheet."""
SCAN_OVER_AXIS = 0.06
"""[m] from the tilt axis up to the scan centre. Assumed, as is all of the tilt unit."""
TOP_OVER_AXIS = SCAN_OVER_AXIS + HEIGHT - CENTRE
"""[m] from the tilt axis up to the top of the level scanner."""
TILT_MASS = 0.3
"""[kg] of the tilt unit."""

_P, _D, _EFFORT, _SPEED = 20.0, 0.3, 2.0, 3.0
"""[N m/rad], [N m s/rad], [N m], [rad/s]: critically damped with the scanner's 0.0012 kg m² about the axis."""
_LOWER, _UPPER = -0.8, 1.2
"""[rad] range of the tilt."""


def add_tilting_lidar(robot: ElementTree.Element, axis: tuple[float, float, float], foot: float) -> None:
    """Adds frame `tilt_mount`, link `tilt` with its actuated joint `tilt_joint`, and link `lidar`.

    `tilt_mount` (x forward, y left, z up) is fixed to the base, its y axis is the tilt axis. A positive angle looks
    down. The origin of `lidar` is the scan centre, its z axis that of the mirror.

    Args:
        axis: where the tilt axis is in the base [m].
        foot: how far below the axis the unit stands on the robot [m].
    """
    add_frame(robot, "tilt_mount", "base", axis)
    base = robot.find("link[@name='base']")
    assert base is not None
    x, y, z = axis
    add_visual(base, _DARK, (x, y, z - (foot + 0.012) / 2), box(0.05, 0.05, foot - 0.012))
    tilt = add_link(robot, "tilt", TILT_MASS, (0.05, 0.07, 0.03))
    add_visual(tilt, _STEEL, (0, 0, 0), cylinder(0.012, 0.07), (math.pi / 2, 0, 0))
    plate = SCAN_OVER_AXIS - CENTRE
    add_visual(tilt, _STEEL, (0, 0, plate / 2), box(WIDTH, WIDTH, plate))
    joint = add_joint(robot, "tilt_joint", "revolute", "tilt", axis)
    ElementTree.SubElement(joint, "axis", xyz=numbers(0, 1, 0))
    limit = {"lower": f"{_LOWER:g}", "upper": f"{_UPPER:g}", "effort": f"{_EFFORT:g}", "velocity": f"{_SPEED:g}"}
    ElementTree.SubElement(joint, "limit", limit)
    add_actuator(robot, "tilt", p=_P, d=_D)

    middle = HEIGHT / 2 - CENTRE
    lidar = add_link(robot, "lidar", MASS, (WIDTH, WIDTH, HEIGHT), (0, 0, middle))
    add_collision(lidar, 0.3, (0, 0, middle), box(WIDTH, WIDTH, HEIGHT))
    add_visual(lidar, _DARK, (0, 0, -CENTRE + 0.02), box(WIDTH, WIDTH, 0.04))
    add_visual(lidar, _GLASS, (0, 0, 0.005 - 0.01), cylinder(0.026, 0.04))
    add_visual(lidar, _DARK, (0, 0, HEIGHT - CENTRE - 0.008), cylinder(0.029, 0.016))
    add_joint(robot, "lidar_weld", "fixed", "lidar", (0, 0, SCAN_OVER_AXIS), parent="tilt")
