"""Writes the URDF file of the amphibious robot from its dimensions: `python -m naraha.models.amphibious.urdf`.

The stronger robot of S3-e: 690 x 650 x 610 mm, 80 kg, limit of 34 degrees uphill. The source shows a photograph and no
more dimensions; what is not in S3-e is assumed: two tracks without flippers, with a raised nose that takes steps, and a
watertight hull between them. Links: `base` (origin at the height of the rear axle where the robot turns on the spot, x
forward, y left, z up), `left_track` and `right_track`, which are native tracks as the crawler's, `imu`, and the tilting
UTM-30LX of `add_tilting_lidar`. Contact of the tracks is spheres, as the crawler's.

Native tracks move as they are told, with any force: the limit uphill is that of friction, atan μ.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from naraha.systems.config import check_config, quantity

from ..belt import Belt, add_belt, outline_around
from ..urdf_xml import Colour, add_collision, add_joint, add_link, add_visual, box, cylinder, urdf_text
from ..utm30lx import TOP_OVER_AXIS, add_tilting_lidar

_YELLOW: Colour = (0.9, 0.68, 0.05)
_RUBBER: Colour = (0.085, 0.085, 0.095)
_STEEL: Colour = (0.45, 0.46, 0.48)
_DARK: Colour = (0.14, 0.15, 0.17)


@dataclass(kw_only=True)
class AmphibiousShape:
    """Dimensions, masses and friction of the amphibious robot. Lengths in [m], masses in [kg]."""

    # [m] length over the tracks, width over the tracks, height with the scanner (S3-e).
    length: float = quantity(0.69, unit="m", above=0.0)
    width: float = quantity(0.65, unit="m", above=0.0)
    height: float = quantity(0.61, unit="m", above=0.0)
    # [m] width of a belt and its outer radius around every pulley.
    belt_width: float = quantity(0.14, unit="m", above=0.0)
    track_radius: float = quantity(0.12, unit="m", above=0.0)
    # [m] how far the nose pulley is higher than the others, and the foremost of those behind it.
    nose_rise: float = quantity(0.05, unit="m", low=0.0)
    nose_run: float = quantity(0.06, unit="m", above=0.0)
    # [m] where the middle of the length is before the origin, which lies where the robot turns on the spot.
    middle: float = quantity(-0.057, unit="m")
    # [m] hull between the tracks: front and rear end before the origin, and bottom and top over ground.
    hull_front: float = quantity(0.243, unit="m", above=0.0)
    hull_rear: float = quantity(-0.387, unit="m")
    hull_bottom: float = quantity(0.11, unit="m", above=0.0)
    hull_top: float = quantity(0.36, unit="m", above=0.0)
    # [m] tilt axis of the LiDAR before the origin.
    tilt_x: float = quantity(0.143, unit="m")
    # See `CrawlerShape`.
    footing_count: int = quantity(9, low=2)
    footing_radius: float = quantity(0.03, unit="m", above=0.0)
    outline_relief: float = quantity(1e-4, unit="m", low=0.0)
    outline_tilt: float = quantity(0.2, unit="rad", above=0.0, high=1.0)

    # [kg] 80 kg in all (S3-e).
    base_mass: float = quantity(61.44, unit="kg", above=0.0)
    track_mass: float = quantity(9.0, unit="kg", above=0.0)
    imu_mass: float = quantity(0.05, unit="kg", above=0.0)
    # [m] centre of mass of the base before the origin and over ground. Low and far from the rear axle: a robot without
    # flippers tips over backwards on a step before its centre of mass is over the edge (see the tests).
    base_mass_x: float = quantity(0.0, unit="m")
    base_mass_height: float = quantity(0.17, unit="m", above=0.0)

    # Friction of the belts, which Drake combines with the ground's as 2 m n / (m + n): 0.683 on the 0.9 of our worlds,
    # the tangent of 34.3 degrees.
    belt_friction: float = quantity(0.55, low=0.0)
    body_friction: float = quantity(0.3, low=0.0)

    @property
    def gauge(self) -> float:
        """Distance of the belts' middle lines [m]."""
        return self.width - self.belt_width

    @property
    def pulleys(self) -> np.ndarray:
        """Centres x, z in the frame of a track of the rear pulley, the front one, and that of the nose, (3, 2) [m]."""
        end = self.length / 2 - self.track_radius
        return np.array([[-end, 0.0], [end - self.nose_run, 0.0], [end, self.nose_rise]])

    @property
    def track_length(self) -> float:
        """Length of a belt that lies on flat ground [m]."""
        return float(self.pulleys[1, 0] - self.pulleys[0, 0])


def amphibious_urdf(shape: AmphibiousShape) -> str:
    """The URDF of a robot of this shape. Raises `ConfigError` when a dimension is out of range."""
    check_config(shape)
    robot = ElementTree.Element("robot", {"name": "amphibious", "xmlns:drake": "http://drake.mit.edu"})
    _add_base(robot, shape)
    for side, sign in (("left", 1), ("right", -1)):
        _add_track(robot, shape, f"{side}_track", sign)
    add_link(robot, "imu", shape.imu_mass, (0.04, 0.04, 0.02))
    add_joint(robot, "imu_weld", "fixed", "imu", (0, 0, 0))
    axis_height = shape.height - TOP_OVER_AXIS
    add_tilting_lidar(robot, (shape.tilt_x, 0.0, axis_height - shape.track_radius), axis_height - shape.hull_top)
    return urdf_text(robot, "naraha.models.amphibious.urdf")


def main() -> None:
    """Rewrites the shipped file, beside this one."""
    (Path(__file__).parent / "amphibious.urdf").write_text(amphibious_urdf(AmphibiousShape()), encoding="utf-8")


def _add_base(robot: ElementTree.Element, shape: AmphibiousShape) -> None:
    r = shape.track_radius
    size = (
        shape.hull_front - shape.hull_rear,
        shape.width - 2 * shape.belt_width - 0.01,
        shape.hull_top - shape.hull_bottom,
    )
    middle = (
        (shape.hull_front + shape.hull_rear) / 2,
        0.0,
        (shape.hull_top + shape.hull_bottom) / 2 - r,
    )
    base = add_link(robot, "base", shape.base_mass, size, (shape.base_mass_x, 0, shape.base_mass_height - r))
    add_collision(base, shape.body_friction, middle, box(*size))
    add_visual(base, _YELLOW, middle, box(*size))
    deck = shape.hull_top - r
    add_visual(base, _DARK, (middle[0] - 0.05, 0, deck + 0.04), box(0.4, size[1] - 0.06, 0.08))
    for sign in (1, -1):
        y = sign * shape.gauge / 2
        add_visual(base, _YELLOW, (shape.middle - 0.04, y, deck - 0.01), box(0.5, shape.belt_width, 0.02))
        add_visual(
            base, _STEEL, (shape.hull_front, sign * 0.1, deck - 0.06), cylinder(0.025, 0.02), (0, math.pi / 2, 0)
        )


def _add_track(robot: ElementTree.Element, shape: AmphibiousShape, name: str, sign: int) -> None:
    r, width, pulleys = shape.track_radius, shape.belt_width, shape.pulleys
    track = add_link(robot, name, shape.track_mass, (shape.length, width, 2 * r))
    # As large as the belt's width leaves room for.
    large = min(r, width / 2)
    belt = Belt(
        friction=shape.belt_friction,
        flat=(pulleys[0, 0], pulleys[1, 0]),
        ground=-r,
        width=width,
        footing_count=shape.footing_count,
        footing_radius=shape.footing_radius,
        outline=outline_around(pulleys, r - large, 2 * large * math.sin(shape.outline_tilt)),
        outline_radius=large - shape.outline_relief,
    )
    add_belt(track, belt, outside=sign)
    across = (math.pi / 2, 0.0, 0.0)
    for (x, z), (x_next, z_next) in pairwise(pulleys):
        length, slope = math.hypot(x_next - x, z_next - z), math.atan2(z_next - z, x_next - x)
        add_visual(track, _RUBBER, ((x + x_next) / 2, 0, (z + z_next) / 2), box(length, width, 2 * r), (0, -slope, 0))
    for x, z in pulleys:
        add_visual(track, _RUBBER, (x, 0, z), cylinder(r, width), across)
        add_visual(track, _STEEL, (x, 0, z), cylinder(0.5 * r, width + 0.008), across)
    add_joint(robot, f"{name}_weld", "fixed", name, (shape.middle, sign * shape.gauge / 2, 0))


if __name__ == "__main__":
    main()
