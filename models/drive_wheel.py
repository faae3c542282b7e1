"""A driven wheel of a robot with two of them and a caster."""

import math
from xml.etree import ElementTree

from .urdf_xml import (
    Colour,
    add_actuator,
    add_collision,
    add_joint,
    add_link,
    add_visual,
    box,
    cylinder,
    numbers,
    sphere,
)


def add_drive_wheel(
    robot: ElementTree.Element,
    name: str,
    y: float,
    *,
    radius: float,
    width: float,
    mass: float,
    friction: float,
    effort: float,
    p: float,
    d: float,
    colours: tuple[Colour, Colour, Colour],
) -> None:
    """Adds the link `name`, its contact as one sphere, the joint `{name}_joint` at (0, y, 0) and its actuator.

    Args:
        y, radius, width: [m]. mass: [kg]. effort: [N m]. p, d: gains, [N m/rad] and [N m s/rad].
        colours: of the tyre, of the rim, and of the bar that shows that it turns.
    """
    tyre, rim, bar = colours
    wheel = add_link(robot, name, mass, (2 * radius, width, 2 * radius))
    add_collision(wheel, friction, (0, 0, 0), sphere(radius))
    across = (math.pi / 2, 0.0, 0.0)
    add_visual(wheel, tyre, (0, 0, 0), cylinder(radius, width - 0.004), across)
    add_visual(wheel, rim, (0, 0, 0), cylinder(0.5 * radius, width), across)
    add_visual(wheel, bar, (0, 0, 0), box(0.9 * radius, width + 0.002, 0.12 * radius))
    joint = add_joint(robot, f"{name}_joint", "continuous", name, (0, y, 0))
    ElementTree.SubElement(joint, "axis", xyz=numbers(0, 1, 0))
    ElementTree.SubElement(joint, "limit", effort=f"{effort:g}")
    add_actuator(robot, name, p=p, d=d)
