"""Writes the URDF file of the Pioneer 3-DX from its dimensions: `python -m naraha.models.pioneer.urdf`.

The weaker robot of S3-e: 455 x 381 x 237 mm, 9 kg, limit of 13 degrees uphill. Links: `base` (origin in the middle of
the axle, x forward, y left, z up), `left_wheel` and `right_wheel` on the joints `{left,right}_wheel_joint` (a positive
speed drives forward), `imu`, and the tilting UTM-30LX of `add_tilting_lidar`. The caster is
assumed to be a sphere that slides with little friction, in place of a swivelling wheel.

Contact of a wheel is one sphere of its radius: an ellipsoid as narrow as the tyre sinks into steps, and a ring of small
spheres loses power at every one of them and is slower to simulate. The price is that the robot is wider in
contact than it looks: at the height of its axle it stops 7 cm from a wall beside it.

What it climbs follows from weights and friction: the batteries weigh on the caster, and little is left on the wheels.
With the share s of the weight W on the wheels on flat ground, the centre of mass h over ground, the caster d behind the
axle, and friction μ of the tyres and c of the caster, the wheels slip on slopes α with

    tan α > (s μ - (1 - s) c) / (1 + (h/d) (μ + c)).

Likewise the wheels, alone in touch with an edge of height z and with the caster free to roll, get over it at walking
pace where the edge's normal is within the friction angle: z < r (1 - cos(atan μ)).
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
    add_joint,
    add_link,
    add_visual,
    box,
    cylinder,
    sphere,
    urdf_text,
)
from ..utm30lx import add_tilting_lidar

_RED: Colour = (0.7, 0.06, 0.08)
_RUBBER: Colour = (0.085, 0.085, 0.095)
_STEEL: Colour = (0.6, 0.61, 0.63)
_DARK: Colour = (0.12, 0.12, 0.13)


@dataclass(kw_only=True)
class PioneerShape:
    """Dimensions, masses, friction and motors of the Pioneer 3-DX. Lengths in [m], masses in [kg]."""

    # [m] radius of the drive wheels. Models in public use have 0.09 to 0.0975.
    wheel_radius: float = quantity(0.0975, unit="m", above=0.0)
    # [m] width of a tyre; the outer sides are 0.381 m apart (S3-e).
    wheel_width: float = quantity(0.05, unit="m", above=0.0)
    wheels_width: float = quantity(0.381, unit="m", above=0.0)
    # [m] front and rear end before the axle: 0.455 m apart (S3-e).
    front: float = quantity(0.188, unit="m", above=0.0)
    rear: float = quantity(-0.267, unit="m")
    # [m] height of the top over ground (S3-e), and of the body's bottom.
    top: float = quantity(0.237, unit="m", above=0.0)
    clearance: float = quantity(0.06, unit="m", above=0.0)
    # [m] caster: how far behind the axle it stands, and its radius. Assumed.
    caster_distance: float = quantity(0.2, unit="m", above=0.0)
    caster_radius: float = quantity(0.0375, unit="m", above=0.0)
    # [m] tilt axis of the LiDAR before the axle and over ground. Assumed.
    tilt_x: float = quantity(0.13, unit="m")
    tilt_height: float = quantity(0.275, unit="m", above=0.0)

    # [kg] 9 kg with base, wheels and IMU (S3-e); scanner and tilt unit come on top.
    base_mass: float = quantity(7.95, unit="kg", above=0.0)
    wheel_mass: float = quantity(0.5, unit="kg", above=0.0)
    imu_mass: float = quantity(0.05, unit="kg", above=0.0)
    # [m] centre of mass of the base before the axle and over ground: the batteries are at the rear. Assumed, so that
    # the limit of 13 degrees comes out.
    base_mass_x: float = quantity(-0.104, unit="m")
    base_mass_height: float = quantity(0.13, unit="m", above=0.0)

    # Friction of the tyres, which Drake combines with the ground's as 2 m n / (m + n): 0.63 on the 0.9 of our worlds.
    # Assumed.
    tyre_friction: float = quantity(0.48, low=0.0)
    # Friction of the caster, which stands for its rolling resistance. Assumed.
    caster_friction: float = quantity(0.02, low=0.0)
    body_friction: float = quantity(0.3, low=0.0)

    # [N m] torque of a wheel: holds 19 degrees, more than the tyres do. Assumed.
    wheel_effort: float = quantity(1.5, unit="N m", above=0.0)
    # [N m/rad], [N m s/rad] control of a wheel, critically damped with its half of the robot (0.046 kg m²).
    wheel_p: float = quantity(60.0, unit="N m/rad", above=0.0)
    wheel_d: float = quantity(3.5, unit="N m s/rad", above=0.0)

    @property
    def gauge(self) -> float:
        """Distance of the wheels' middle planes [m]."""
        return self.wheels_width - self.wheel_width


def pioneer_urdf(shape: PioneerShape) -> str:
    """The URDF of a Pioneer of this shape. Raises `ConfigError` when a dimension is out of range."""
    check_config(shape)
    robot = ElementTree.Element("robot", {"name": "pioneer", "xmlns:drake": "http://drake.mit.edu"})
    _add_base(robot, shape)
    for side, sign in (("left", 1), ("right", -1)):
        _add_wheel(robot, shape, f"{side}_wheel", sign * shape.gauge / 2)
    add_link(robot, "imu", shape.imu_mass, (0.04, 0.04, 0.02))
    add_joint(robot, "imu_weld", "fixed", "imu", (0, 0, 0))
    axis = (shape.tilt_x, 0.0, shape.tilt_height - shape.wheel_radius)
    add_tilting_lidar(robot, axis, shape.tilt_height - shape.top)
    return urdf_text(robot, "naraha.models.pioneer.urdf")


def main() -> None:
    """Rewrites the shipped file, beside this one."""
    (Path(__file__).parent / "pioneer.urdf").write_text(pioneer_urdf(PioneerShape()), encoding="utf-8")


def _add_base(robot: ElementTree.Element, shape: PioneerShape) -> None:
    r = shape.wheel_radius
    length, width = shape.front - shape.rear, shape.wheels_width - 2 * shape.wheel_width - 0.01
    height = shape.top - shape.clearance
    middle = ((shape.front + shape.rear) / 2, 0.0, (shape.top + shape.clearance) / 2 - r)
    base = add_link(
        robot, "base", shape.base_mass, (length, width, height), (shape.base_mass_x, 0, shape.base_mass_height - r)
    )
    add_collision(base, shape.body_friction, middle, box(length, width, height))
    caster = (-shape.caster_distance, 0.0, shape.caster_radius - r)
    add_collision(base, shape.caster_friction, caster, sphere(shape.caster_radius))
    plate = 0.012
    add_visual(base, _RED, (middle[0], 0, middle[2] - plate / 2), box(length - 0.04, width, height - plate))
    add_visual(base, _DARK, (middle[0], 0, shape.top - plate / 2 - r), box(length, width + 0.06, plate))
    add_visual(base, _DARK, (shape.front - 0.02, 0, middle[2] + 0.02), box(0.02, width - 0.03, 0.04))
    add_visual(base, _STEEL, (-shape.caster_distance, 0, shape.clearance - r), cylinder(0.02, 0.02))
    across = (math.pi / 2, 0.0, 0.0)
    add_visual(base, _RUBBER, caster, cylinder(shape.caster_radius, 0.03), across)


def _add_wheel(robot: ElementTree.Element, shape: PioneerShape, name: str, y: float) -> None:
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
        colours=(_RUBBER, _STEEL, _RED),
    )


if __name__ == "__main__":
    main()
