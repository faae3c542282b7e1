"""What a survey found, in Meshcat: classes and dose rate of the finished map, puddles, hot regions and sources.

All of it is there from the start of a recording: these are results, and whoever opens one of them wants to see it.
"""

import math
from collections.abc import Sequence

import numpy as np
from open3d.t.geometry import PointCloud
from pydrake.geometry import Ellipsoid, Meshcat, Rgba, Sphere
from pydrake.math import RigidTransform

from ..errors import InputError
from ..hazards.classes import CLASSES, OTHER, SOURCE
from .colours import DOSE_RATE, ColourScale, for_meshcat
from .keyframe_display import drake_cloud
from .semantic_display import layer_path, thin, values_of

# Where things are drawn that lie on any of the layers.
REGIONS, SOURCES = "regions", "sources"
# Points above this are not drawn, so that one can look into a room [m].
MAX_HEIGHT = 2.2


def draw_classes(
    meshcat: Meshcat, cloud: PointCloud, *, most: int = 60000, point_size: float = 0.05, max_height: float = MAX_HEIGHT
) -> None:
    """Draws a map by class, hidden at first, at `layers/classes/<class>`.

    Args:
        cloud: the map, in M, with `label`.
        most: points that are kept of the class `other`; all points of the other classes are drawn.
        point_size: edge length of a point [m].
        max_height: points above this are left out [m].

    Raises:
        InputError: the cloud has no `label`.
    """
    points, labels = _points(cloud), _require(cloud, "label")
    _begin(meshcat, "classes")
    for one in CLASSES:
        kept = (labels == one.id) & (points[:, 2] < max_height)
        shown = thin(kept, most if one is OTHER else len(points))
        if len(shown) > 0:
            path = f"{layer_path('classes')}/{one.name}"
            size = point_size if one is OTHER else 1.2 * point_size
            meshcat.SetObject(path, drake_cloud(points[shown]), point_size=size, rgba=screen_rgba(one.colour))


def draw_attribute(
    meshcat: Meshcat,
    layer: str,
    cloud: PointCloud,
    attribute: str,
    scale: ColourScale,
    *,
    most: int = 60000,
    point_size: float = 0.05,
    max_height: float = MAX_HEIGHT,
) -> None:
    """Draws the points of a map, in M, whose `attribute` is known, hidden at first, at `layers/<layer>/points`.

    The other arguments are those of `draw_classes`. Raises `InputError` when the cloud has no such attribute.
    """
    points, values = _points(cloud), _require(cloud, attribute)
    _begin(meshcat, layer)
    shown = thin(np.isfinite(values) & (points[:, 2] < max_height), most)
    if len(shown) > 0:
        drawn = drake_cloud(points[shown], for_meshcat(scale.colours(values[shown])))
        meshcat.SetObject(f"{layer_path(layer)}/points", drawn, point_size=point_size)


def draw_dose(meshcat: Meshcat, cloud: PointCloud, scale: ColourScale | None = None) -> ColourScale:
    """Draws the map's `dose_rate` [µSv/h] as layer `dose`, and returns the scale that its legend needs.

    See `draw_attribute`. Without `scale` it is the powers of ten that the values lie between. Values that are not
    positive have the colour of the low end.
    """
    scale = scale or decades(_require(cloud, "dose_rate"), DOSE_RATE)
    draw_attribute(meshcat, "dose", cloud, "dose_rate", scale)
    return scale


def decades(values: np.ndarray, scale: ColourScale) -> ColourScale:
    """`scale` from one power of ten to another, around the middle 98 % of the positive values; as it is without any."""
    positive = values[np.isfinite(values) & (values > 0)]
    if len(positive) == 0:
        return scale
    low, high = np.log10(np.percentile(positive, [1.0, 99.0]))
    first = math.floor(low + 1e-6)
    last = max(math.ceil(high - 1e-6), first + 1)
    return ColourScale(
        title=scale.title, unit=scale.unit, low=10.0**first, high=10.0**last, palette=scale.palette, log=True
    )


def draw_regions(
    meshcat: Meshcat,
    name: str,
    outlines: Sequence[np.ndarray],
    z: float | Sequence[float],
    colour: tuple[int, int, int],
    *,
    width: float = 0.04,
) -> None:
    """Draws outlines as flat ribbons at `regions/<name>`, in place of those that were there.

    Args:
        outlines: closed polygons in M, (K, 2) each, the last point not repeated [m].
        z: height of all of them, or of each [m].
        colour: red, green and blue on the screen.
        width: of the ribbon [m]. (A line would be one pixel wide in most browsers.)

    Raises:
        InputError: an outline is not a polygon, or the heights are not as many.
    """
    meshcat.Delete(f"{REGIONS}/{name}")
    if len(outlines) == 0:
        return
    heights = np.broadcast_to(np.asarray(z, float), len(outlines)) if np.ndim(z) == 0 else np.asarray(z, float)
    if heights.shape != (len(outlines),):
        raise InputError("not one height an outline", where=name, key="z", value=z, valid=f"{len(outlines)} heights")
    quads = []
    for i, (outline, height) in enumerate(zip(outlines, heights, strict=True)):
        outline = np.asarray(outline, float)
        if outline.ndim != 2 or outline.shape[1:] != (2,) or len(outline) < 3 or not np.isfinite(outline).all():
            raise InputError("not a polygon", where=name, key=f"outlines[{i}]", valid="(K, 2) finite, K >= 3")
        flat = ribbon(outline, width)
        quads.append(np.concatenate([flat, np.full((*flat.shape[:2], 1), height)], axis=2))
    corners = np.concatenate(quads).reshape(-1, 3)
    halves = np.array([[0, 1, 2], [0, 2, 3]])
    faces = (4 * np.arange(len(corners) // 4)[:, None, None] + halves).reshape(-1, 3)
    meshcat.SetTriangleMesh(f"{REGIONS}/{name}", corners.T, faces.T.astype(np.int32), screen_rgba(colour))


def ribbon(outline: np.ndarray, width: float) -> np.ndarray:
    """The edges of a closed polygon (K, 2) as rectangles of a width [m] that overlap at its corners, (E, 4, 2)."""
    a, b = outline, np.roll(outline, -1, axis=0)
    length = np.linalg.norm(b - a, axis=1, keepdims=True)
    a, b, length = (part[length[:, 0] > 0] for part in (a, b, length))
    along = 0.5 * width * (b - a) / length
    across = along[:, ::-1] * [-1.0, 1.0]
    return np.stack([a - along - across, b + along - across, b + along + across, a - along + across], axis=1)


def draw_source(
    meshcat: Meshcat, p_MQ: np.ndarray, sigma: float | np.ndarray, *, name: str = "0", radius: float = 0.1
) -> None:
    """Draws a radiation source at `sources/<name>`, and around it the region of two standard deviations.

    Args:
        p_MQ: where it is, (3,) [m].
        sigma: standard deviation of the position, one or one along each axis of M [m].
        name: to tell several sources apart.
        radius: of the ball that marks it [m].

    Raises:
        InputError: position or deviation is not finite, or a deviation is negative.
    """
    p_MQ, spread = np.asarray(p_MQ, float), np.asarray(sigma, float)
    if p_MQ.shape != (3,) or not np.isfinite(p_MQ).all():
        raise InputError("not a position", where="source", key="p_MQ", value=p_MQ.tolist(), valid="(3,) finite")
    if spread.shape not in ((), (3,)) or not (np.isfinite(spread).all() and (spread >= 0).all()):
        valid = "one number or (3,), finite and not negative"
        raise InputError("not a deviation", where="source", key="sigma", value=spread.tolist(), valid=valid)
    axes = np.maximum(2.0 * np.broadcast_to(spread, 3), 1e-3)
    ball, region = screen_rgba(SOURCE.colour), screen_rgba(SOURCE.colour, alpha=0.25)
    meshcat.SetObject(f"{SOURCES}/{name}/position", Sphere(radius), ball)
    meshcat.SetObject(f"{SOURCES}/{name}/region", Ellipsoid(*axes), region)
    meshcat.SetTransform(f"{SOURCES}/{name}", RigidTransform(p_MQ))


def screen_rgba(colour: tuple[int, int, int], alpha: float = 1.0) -> Rgba:
    """A colour on the screen, 0 to 255, as Meshcat takes it for a whole object."""
    red, green, blue = (channel / 255.0 for channel in colour)
    return Rgba(red, green, blue, alpha)


def _begin(meshcat: Meshcat, name: str) -> None:
    meshcat.Delete(layer_path(name))
    meshcat.SetProperty(layer_path(name), "visible", False)


def _points(cloud: PointCloud) -> np.ndarray:
    if "positions" not in cloud.point:
        return np.zeros((0, 3))
    return cloud.point.positions.numpy()


def _require(cloud: PointCloud, attribute: str) -> np.ndarray:
    values = values_of(cloud, attribute)
    if values is None:
        have = [name for name, _ in cloud.point.items()]
        raise InputError("the cloud has no such attribute", key=attribute, valid=have)
    return values
