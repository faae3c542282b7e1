"""The belt of a native track: its outline, its contact spheres, and the axis around which its surface runs."""

import math
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from .urdf_xml import add_collision, sphere


@dataclass(frozen=True, kw_only=True, eq=False)
class Belt:
    """Contact of a belt, in the frame of its link: x along it, y to the left, z up. Lengths in [m].

    A few small spheres, the footing, carry it on flat ground at both of its edges. A row of large ones that lie a
    little higher, the outline, are what an edge slides over.

    Attributes:
        friction: of the belt.
        flat: x of the rear and of the front end of the part that lies on flat ground.
        ground: z of flat ground.
        width: of the belt.
        footing_count, footing_radius: of the footing. Each sphere stands in the middle of an equal part of `flat`, so
            that they turn like a uniform load.
        outline: (N, 2) centres x, z. outline_radius: of these spheres.
    """

    friction: float
    flat: tuple[float, float]
    ground: float
    width: float
    footing_count: int
    footing_radius: float
    outline: np.ndarray
    outline_radius: float


def add_belt(track: ElementTree.Element, belt: Belt, *, outside: int) -> None:
    """Gives a link the contact of a belt; `outside` is 1 on the robot's left side and -1 on its right."""
    rear, front = belt.flat
    for i in range(belt.footing_count):
        x = rear + (i + 0.5) / belt.footing_count * (front - rear)
        y = outside * (belt.width / 2 - belt.footing_radius) * (1 if i % 2 == 0 else -1)
        centre = (x, y, belt.footing_radius + belt.ground)
        add_collision(track, belt.friction, centre, sphere(belt.footing_radius))
    for x, z in belt.outline:
        add_collision(track, belt.friction, (x, 0, z), sphere(belt.outline_radius))
    # The surface runs around +y: a positive speed drives the robot forward.
    ElementTree.SubElement(track, "drake:surface_velocity_axis", axis="0 1 0")


def outline_around(centres: np.ndarray, radius: float, spacing: float) -> np.ndarray:
    """Evenly spaced points on the lower half of a belt around equal pulleys, in the plane of the belt.

    The line runs below the pulleys, from the top of the rearmost up to the top of the foremost.

    Args:
        centres: (P, 2) x, z of the pulleys from rear to front [m]; what they lie below of is convex.
        radius: of the line around the pulleys [m].
        spacing: largest distance of neighbours along the line [m].

    Returns:
        (N, 2) points x, z [m].
    """
    runs = np.diff(centres, axis=0)
    tilts = np.arctan2(runs[:, 1], runs[:, 0])
    # The line leaves a pulley where it is at right angles to the run.
    leave = np.concatenate([[-3 * math.pi / 2], tilts - math.pi / 2, [math.pi / 2]])
    points: list[np.ndarray] = []
    for i, centre in enumerate(centres):
        count = 1 + math.ceil(radius * (leave[i + 1] - leave[i]) / spacing - 1e-9)
        angles = np.linspace(leave[i], leave[i + 1], max(count, 1))
        arc = centre + radius * np.column_stack([np.cos(angles), np.sin(angles)])
        if points:
            start = points[-1][-1]
            share = np.linspace(0, 1, 1 + math.ceil(float(np.linalg.norm(arc[0] - start)) / spacing - 1e-9))
            points.append(start + share[1:-1, None] * (arc[0] - start))
        points.append(arc)
    return np.vstack(points)
