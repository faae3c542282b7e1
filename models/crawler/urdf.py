"""Writes the URDF files of the crawler from one set of dimensions: `python -m naraha.models.crawler.urdf`.

The robot is the tracked crawler of S0-j and S2 (1.0 m long with the flippers out flat, 0.4 m wide, body 0.2 m high).
Its links are `base` (origin between the track axles at axle height, x forward, y left, z up), `left_track`,
`right_track`, four flippers `{front,rear}_{left,right}_flipper`, `lidar`, `imu` and `mast`, the head over the LiDAR.
The head has frames for what it carries: `depth_camera` and `thermal_camera` (optical frames: x right, y down, z
forward), `nir_mount` of the pan-tilt (x forward, y left, z up), `lamp` and `gamma_counter`. Tracks and flippers are
native tracks of Drake: links whose surface runs around +y with the speed on the plant's `surface_speeds` port, so that
a positive speed drives the robot forward. A flipper's angle is 0 when it lies flat and positive with its tip up.

Contact geometry is spheres alone: they are the only shape whose contact on an edge Drake computes in closed form
(capsules and ellipsoids were tried; their normal on a stair nosing came out as the riser's). A belt has a few small
spheres, the `footing`, that carry it on flat ground at both of its edges, and a dense row of large ones 0.1 mm
higher, the `outline`, over which an edge slides smoothly. A flipper has an outline only.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from naraha.systems.config import check_config, quantity
from naraha.systems.errors import ConfigError

from ..belt import Belt, add_belt
from ..urdf_xml import (
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
    sphere,
    urdf_text,
)

_ORANGE: Colour = (0.93, 0.36, 0.03)
_RUBBER: Colour = (0.085, 0.085, 0.095)
_STEEL: Colour = (0.45, 0.46, 0.48)
_DARK: Colour = (0.14, 0.15, 0.17)
_LAMP: Colour = (1.0, 0.95, 0.75)
_GLASS: Colour = (0.03, 0.04, 0.08)


@dataclass(kw_only=True)
class CrawlerShape:
    """Dimensions, masses and friction of the crawler. Lengths in [m], masses in [kg]."""

    # [m] width of each main belt: 80 mm, before that 40 mm (S0-j). The outer edge stays where it is.
    belt_width: float = quantity(0.08, unit="m", above=0.0, high=0.12)
    # [m] outer edge of the main belts from the middle; the flippers run outside it: 2 * (0.16 + 0.04) = 0.40 (S2).
    belt_outer_edge: float = quantity(0.16, unit="m", above=0.0)
    # [m] width of the flipper belts, what the over-all width leaves beside the main belts.
    flipper_width: float = quantity(0.04, unit="m", above=0.0)
    # [m] distance of the axles of a main track, the length that lies on flat ground. With the flippers 1.0 m (S2).
    track_length: float = quantity(0.46, unit="m", above=0.0)
    # [m] outer radius of the main belt around its axles; the belly clears what is lower than 45 mm.
    track_radius: float = quantity(0.08, unit="m", above=0.0)
    # [m] from the axle of a flipper to the axle of its tip pulley.
    flipper_length: float = quantity(0.23, unit="m", above=0.0)
    # [m] outer radius of a flipper at its root: less than the track's, so that a flat flipper does not touch the floor.
    flipper_root_radius: float = quantity(0.07, unit="m", above=0.0)
    # [m] outer radius of a flipper at its tip.
    flipper_tip_radius: float = quantity(0.04, unit="m", above=0.0)
    # [m] body box between the tracks: half length, half width, bottom and top over the axles (0.2 m over ground, S2).
    body_half_length: float = quantity(0.26, unit="m", above=0.0)
    body_half_width: float = quantity(0.075, unit="m", above=0.0)
    body_bottom: float = quantity(-0.035, unit="m")
    body_top: float = quantity(0.12, unit="m")
    # [m] scan centre of the VLP-16 over the axles: 0.30 m over ground. Its lowest ring (-15 deg) passes over the body.
    lidar_height: float = quantity(0.22, unit="m", above=0.0)
    # Number of footing spheres of a belt, alternately at its inner and outer edge. Each stands in the middle of an
    # equal part of the track's length, so that they turn like a uniform load: 9 and 17 give the same yaw rate within
    # 0.5 % (tests/drive/test_crawler_physics.py).
    footing_count: int = quantity(9, low=2)
    # [m] radius of the footing spheres; a belt of twice that width has them all on its middle line.
    footing_radius: float = quantity(0.02, unit="m", above=0.0)
    # [m] how much higher the outline lies: more than the footing sinks in (0.03 mm), or it would carry on the flat.
    outline_relief: float = quantity(1e-4, unit="m", low=0.0)
    # [rad] by how much an edge between two spheres of the outline may tilt the contact normal, and so lower the
    # steepest stair that friction holds. Finer costs time: every sphere is moved in every step.
    outline_tilt: float = quantity(0.2, unit="rad", above=0.0, high=1.0)

    # [m] height of the cameras over the axles: 0.56 m over ground, so that a floor 5 m away is seen at 6 deg.
    head_height: float = quantity(0.48, unit="m", above=0.0)
    # [m] height of the near-infrared lamp over the axles; below the cameras, so that they see past its shadows.
    lamp_height: float = quantity(0.36, unit="m", above=0.0)
    # [rad] how far the depth camera and the pan-tilt look down.
    head_pitch: float = quantity(math.radians(10.0), unit="rad")

    # Masses add up to 30.6 kg: comparable are CSIRO's DTR (about 30 kg, body 16.2 kg) and Absolem (body 16.0 kg,
    # track 6.1 kg, flipper 0.75 kg), both from osrf/subt.
    # [kg] chassis with batteries, motors and computer.
    base_mass: float = quantity(16.0, unit="kg", above=0.0)
    # [m] height of the chassis's centre of mass over the axles; batteries lie low.
    base_mass_height: float = quantity(0.02, unit="m")
    # [kg] one main track.
    track_mass: float = quantity(5.0, unit="kg", above=0.0)
    # [kg] one flipper.
    flipper_mass: float = quantity(0.75, unit="kg", above=0.0)
    # [kg] VLP-16, data sheet.
    lidar_mass: float = quantity(0.83, unit="kg", above=0.0)
    # [kg] IMU module.
    imu_mass: float = quantity(0.05, unit="kg", above=0.0)
    # [kg] pole and head with cameras, pan-tilt, lamp and counter. Assumed.
    mast_mass: float = quantity(0.7, unit="kg", above=0.0)

    # Friction of the belts, rubber with cleats. Drake combines two surfaces as 2 m n / (m + n), so that ground of 1.0
    # makes it 1.05: just over the tan(45 deg) of S2's steepest slope.
    belt_friction: float = quantity(1.1, low=0.0)
    # Friction of the body: metal sliding over an edge.
    body_friction: float = quantity(0.3, low=0.0)

    # [N m] a flipper's torque: twice what lifting half of the robot on one tip needs (MARV: 120 N m for 61 kg).
    flipper_effort: float = quantity(70.0, unit="N m", above=0.0)
    # [rad/s] a flipper's speed (Absolem).
    flipper_speed: float = quantity(0.8, unit="rad/s", above=0.0)
    # [rad] range of a flipper, tip up positive.
    flipper_lower: float = quantity(-1.6, unit="rad")
    flipper_upper: float = quantity(1.6, unit="rad")
    # [N m/rad], [N m s/rad] position control of a flipper: half the robot on one tip bends it by 0.06 rad.
    flipper_p: float = quantity(600.0, unit="N m/rad", above=0.0)
    flipper_d: float = quantity(30.0, unit="N m s/rad", above=0.0)


CRAWLERS = {"crawler": CrawlerShape(), "crawler_narrow_belt": CrawlerShape(belt_width=0.04)}
"""The shipped robots: file stem and shape."""


def belt_outline(
    rear_radius: float, front_radius: float, length: float, spacing: float, *, rear_arc: bool
) -> np.ndarray:
    """Evenly spaced points on the lower half of a belt around two pulleys, in the plane of the belt.

    The line runs below the pulleys from the one at (0, 0) to the one at (length, 0) and up to the top of the front
    one. With `rear_arc` it starts at the top of the rear pulley, otherwise where the lower run leaves it.

    Args:
        rear_radius, front_radius: radii of the line around the pulleys [m].
        length: distance of the pulleys [m].
        spacing: largest distance of neighbours along the line [m].

    Returns:
        (N, 2) points x, z [m].
    """
    taper = math.asin((rear_radius - front_radius) / length)
    run = length * math.cos(taper)
    n = np.array([math.sin(taper), -math.cos(taper)])

    def arc(centre_x: float, radius: float, start: float, end: float) -> np.ndarray:
        angle = np.linspace(start, end, 1 + math.ceil(radius * abs(end - start) / spacing))
        return np.column_stack([centre_x + radius * np.cos(angle), radius * np.sin(angle)])

    start, end = rear_radius * n, np.array([length, 0.0]) + front_radius * n
    bottom = np.linspace(start, end, 1 + math.ceil(run / spacing - 1e-9))
    lowest = taper - math.pi / 2
    front = arc(length, front_radius, lowest, math.pi / 2 - taper)
    rear = arc(0.0, rear_radius, -3 * math.pi / 2 - taper, lowest)
    return np.vstack([*([rear[:-1]] if rear_arc else []), bottom, front[1:]])


def crawler_urdf(shape: CrawlerShape) -> str:
    """The URDF of a crawler of this shape.

    Raises:
        ConfigError: a dimension is out of range, or the parts do not fit into each other.
    """
    check_config(shape)
    inner_edge = shape.belt_outer_edge - shape.belt_width
    if inner_edge < shape.body_half_width:
        raise ConfigError(
            "the belt cuts into the body",
            key="belt_width",
            value=shape.belt_width,
            valid=f"<= {shape.belt_outer_edge - shape.body_half_width:g} m",
        )
    if shape.belt_width < 2 * shape.footing_radius:
        raise ConfigError(
            "the footing does not fit into the belt",
            key="footing_radius",
            value=shape.footing_radius,
            valid=f"<= {shape.belt_width / 2:g} m",
        )
    robot = ElementTree.Element("robot", {"name": "crawler", "xmlns:drake": "http://drake.mit.edu"})
    _add_base(robot, shape)
    for side, sign in (("left", 1), ("right", -1)):
        _add_track(robot, shape, side, sign)
    for end in ("front", "rear"):
        for side, sign in (("left", 1), ("right", -1)):
            _add_flipper(robot, shape, end, side, sign)
    _add_sensors(robot, shape)
    # Neighbouring belts overlap at the axles.
    return urdf_text(robot, "naraha.models.crawler.urdf")


def main() -> None:
    """Rewrites the shipped files, beside this one."""
    for stem, shape in CRAWLERS.items():
        (Path(__file__).parent / f"{stem}.urdf").write_text(crawler_urdf(shape), encoding="utf-8")


def _add_base(robot: ElementTree.Element, shape: CrawlerShape) -> None:
    height = shape.body_top - shape.body_bottom
    size = (2 * shape.body_half_length, 2 * shape.body_half_width, height)
    middle = (0.0, 0.0, (shape.body_top + shape.body_bottom) / 2)
    base = add_link(robot, "base", shape.base_mass, size, (0.0, 0.0, shape.base_mass_height))
    add_collision(base, shape.body_friction, middle, box(*size))
    deck = shape.body_top - shape.track_radius - 0.006  # the deck lies over the belts
    top = shape.body_top
    add_visual(base, _DARK, (0, 0, middle[2] - deck / 2), box(size[0] - 0.04, size[1], height - deck))
    add_visual(base, _ORANGE, (0, 0, top - deck / 2), box(size[0], 2 * shape.belt_outer_edge - 0.01, deck))
    add_visual(base, _DARK, (-0.02, 0, top), box(0.34, 0.16, 0.012))
    x_front = shape.body_half_length - 0.015
    add_visual(base, _ORANGE, (x_front, 0, middle[2]), box(0.03, 2 * shape.body_half_width, height - 0.02))
    for y in (-0.045, 0.045):
        add_visual(base, _LAMP, (x_front + 0.015, y, 0.045), cylinder(0.014, 0.01), (0, math.pi / 2, 0))
    add_visual(base, _GLASS, (x_front + 0.016, 0, 0.045), box(0.012, 0.03, 0.022))
    foot = shape.lidar_height - _LIDAR_CENTRE
    add_visual(base, _DARK, (0, 0, (top + foot) / 2), cylinder(0.03, foot - top))


def _add_track(robot: ElementTree.Element, shape: CrawlerShape, side: str, sign: int) -> None:
    r, length, width = shape.track_radius, shape.track_length, shape.belt_width
    track = add_link(robot, f"{side}_track", shape.track_mass, (length + 2 * r, width, 2 * r))
    y = sign * (shape.belt_outer_edge - width / 2)
    # As large as the belt's radius, or as the over-all width leaves room for.
    large = min(r, shape.belt_outer_edge + shape.flipper_width - abs(y))
    spacing = 2 * large * math.sin(shape.outline_tilt)
    belt = Belt(
        friction=shape.belt_friction,
        flat=(-length / 2, length / 2),
        ground=-r,
        width=width,
        footing_count=shape.footing_count,
        footing_radius=shape.footing_radius,
        outline=belt_outline(r - large, r - large, length, spacing, rear_arc=True) - [length / 2, 0],
        outline_radius=large - shape.outline_relief,
    )
    add_belt(track, belt, outside=sign)
    across = (math.pi / 2, 0.0, 0.0)
    add_visual(track, _RUBBER, (0, 0, 0), box(length, width, 2 * r))
    for x in (-length / 2, length / 2):
        add_visual(track, _RUBBER, (x, 0, 0), cylinder(r, width), across)
    for x in np.linspace(-0.3, 0.3, 4) * length:
        add_visual(track, _STEEL, (x, 0, -0.02), cylinder(0.045, width + 0.008), across)
    add_joint(robot, f"{side}_track_weld", "fixed", f"{side}_track", (0, y, 0))


def _add_flipper(robot: ElementTree.Element, shape: CrawlerShape, end: str, side: str, sign: int) -> None:
    forward = 1 if end == "front" else -1
    root, tip = shape.flipper_root_radius, shape.flipper_tip_radius
    length, width = shape.flipper_length, shape.flipper_width
    name = f"{end}_{side}_flipper"
    size = (length + root + tip, width, root + tip)
    centre_x = forward * (length + tip - root) / 2
    flipper = add_link(robot, name, shape.flipper_mass, size, (centre_x, 0, 0))
    # Spheres as large as the tip, flush with the outer side of the belt.
    spacing = 2 * tip * math.sin(shape.outline_tilt)
    for x, z in belt_outline(root - tip, 0.0, length, spacing, rear_arc=False):
        add_collision(flipper, shape.belt_friction, (forward * x, sign * (width / 2 - tip), z), sphere(tip))
    ElementTree.SubElement(flipper, "drake:surface_velocity_axis", axis="0 1 0")
    across = (math.pi / 2, 0.0, 0.0)
    hull = width - 0.01  # the hubs stand out by 5 mm and end at the over-all width
    add_visual(flipper, _RUBBER, (0, 0, 0), cylinder(root, hull), across)
    add_visual(flipper, _RUBBER, (forward * length, 0, 0), cylinder(tip, hull), across)
    # The straight runs of the belt: two boxes as thick as the root's radius, each with a face on a common tangent.
    taper = math.asin((root - tip) / length)
    x = forward * (length + tip * math.sin(taper)) / 2
    run = box(length * math.cos(taper), hull, root)
    for up in (1, -1):
        add_visual(flipper, _RUBBER, (x, 0, up * tip * math.cos(taper) / 2), run, (0, up * forward * taper, 0))
    add_visual(flipper, _ORANGE, (0, 0, 0), cylinder(0.6 * root, width), across)
    add_visual(flipper, _STEEL, (forward * length, 0, 0), cylinder(0.55 * tip, width), across)
    joint = add_joint(
        robot,
        f"{name}_joint",
        "revolute",
        name,
        (forward * shape.track_length / 2, sign * (shape.belt_outer_edge + width / 2), 0),
    )
    ElementTree.SubElement(joint, "axis", xyz=numbers(0, -forward, 0))
    ElementTree.SubElement(
        joint,
        "limit",
        lower=f"{shape.flipper_lower:g}",
        upper=f"{shape.flipper_upper:g}",
        effort=f"{shape.flipper_effort:g}",
        velocity=f"{shape.flipper_speed:g}",
    )
    add_actuator(robot, name, p=shape.flipper_p, d=shape.flipper_d)


_LIDAR_RADIUS, _LIDAR_LENGTH, _LIDAR_CENTRE = 0.0516, 0.0717, 0.0377
"""VLP-16 [m]: cylinder, and its scan centre over its foot."""


def _add_sensors(robot: ElementTree.Element, shape: CrawlerShape) -> None:
    """The LiDAR's origin is its scan centre; the IMU sits in the origin of the base and so has no lever arm."""
    size = (2 * _LIDAR_RADIUS, 2 * _LIDAR_RADIUS, _LIDAR_LENGTH)
    middle = _LIDAR_LENGTH / 2 - _LIDAR_CENTRE
    lidar = add_link(robot, "lidar", shape.lidar_mass, size, (0, 0, middle))
    add_collision(lidar, shape.body_friction, (0, 0, middle), cylinder(_LIDAR_RADIUS, _LIDAR_LENGTH))
    foot, top = -_LIDAR_CENTRE, _LIDAR_LENGTH - _LIDAR_CENTRE
    for colour, low, high in ((_STEEL, foot, -0.02), (_GLASS, -0.02, 0.018), (_STEEL, 0.018, top)):
        radius = _LIDAR_RADIUS - (0.001 if colour is _GLASS else 0.0)
        add_visual(lidar, colour, (0, 0, (low + high) / 2), cylinder(radius, high - low))
    add_joint(robot, "lidar_weld", "fixed", "lidar", (0, 0, shape.lidar_height))
    add_link(robot, "imu", shape.imu_mass, (0.04, 0.04, 0.02))
    add_joint(robot, "imu_weld", "fixed", "imu", (0, 0, 0))
    _add_mast(robot, shape, shape.lidar_height + top)


def _add_mast(robot: ElementTree.Element, shape: CrawlerShape, foot: float) -> None:
    """The mast's origin is on the LiDAR's axis at the height of the cameras. It has no contact geometry."""
    pole = shape.head_height - foot
    mast = add_link(robot, "mast", shape.mast_mass, (0.05, 0.2, 0.1))
    add_joint(robot, "mast_weld", "fixed", "mast", (0, 0, shape.head_height))
    add_visual(mast, _DARK, (0, 0, -pole / 2), cylinder(0.015, pole))
    add_visual(mast, _DARK, (0, 0, 0), box(0.05, 0.24, 0.05))
    add_visual(mast, _STEEL, (0.03, 0, 0), box(0.02, 0.099, 0.023), (0, shape.head_pitch, 0))  # a D415
    add_visual(mast, _ORANGE, (0.035, -0.09, 0), box(0.06, 0.045, 0.045), (0, shape.head_pitch, 0))
    add_visual(mast, _STEEL, (0.03, 0.09, 0), box(0.02, 0.04, 0.04))
    lamp_z = shape.lamp_height - shape.head_height
    add_visual(mast, _LAMP, (0.03, 0, lamp_z), cylinder(0.02, 0.02), (0, math.pi / 2, 0))
    add_visual(mast, _DARK, (-0.04, 0, 0), cylinder(0.02, 0.08))
    down = (0.0, shape.head_pitch, 0.0)
    optical = (-math.pi / 2, 0.0, -math.pi / 2)
    optical_down = (-math.pi / 2 - shape.head_pitch, 0.0, -math.pi / 2)
    add_frame(robot, "depth_camera", "mast", (0.04, 0, 0), optical_down)
    add_frame(robot, "nir_mount", "mast", (0.04, -0.09, 0), down)
    add_frame(robot, "thermal_camera", "mast", (0.04, 0.09, 0), optical)
    add_frame(robot, "lamp", "mast", (0.04, 0, lamp_z), down)
    add_frame(robot, "gamma_counter", "mast", (-0.04, 0, 0))


if __name__ == "__main__":
    main()
