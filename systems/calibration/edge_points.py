"""Edges of depth images, as points in space, and of other images, in fractions of a pixel."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ..sensing.camera_model import CameraModel

# [px] A line is fitted to this many neighbours of an edge pixel, at most this far away. It must pass them closer
# than _STRAIGHT on average, or the place is a corner.
_NEIGHBOURS, _REACH, _STRAIGHT = 13, 7.0, 0.5
# [px] Distance between the two points that show an edge's direction in space.
_LENGTH = 3.0


@dataclass(frozen=True, eq=False)
class SpaceEdges:
    """N points on edges that the depth camera D sees.

    Attributes:
        p_DP: the points, (N, 3) [m].
        t_DP: direction of the edge, from the point to another one on it, (N, 3) [m].
        group: number of the straight piece of edge that the point is on, (N,) int; their errors are alike.
    """

    p_DP: np.ndarray
    t_DP: np.ndarray
    group: np.ndarray


@dataclass(frozen=True, eq=False)
class ImageEdges:
    """M pixels on edges of an image.

    Attributes:
        uv: where the gradient is largest across the edge, to fractions of a pixel, (M, 2).
        normal: unit direction of the gradient, towards the brighter side, (M, 2).
    """

    uv: np.ndarray
    normal: np.ndarray


def space_edges(
    depth: np.ndarray, camera: CameraModel, *, min_jump: float, jump_per_z2: float, brightness: np.ndarray | None = None
) -> SpaceEdges:
    """Where the foreground ends in a depth image, and with `brightness`, where that has edges.

    Two neighbouring pixels are on either side of an edge when their depths, after a median over 3 × 3 pixels, differ by
    more than `min_jump` + `jump_per_z2` z², z the larger one. The point is half a pixel outside the nearer one,
    moved onto a line through its neighbours, at the mean depth of theirs. Infinity is far away; depth that is zero or
    NaN is unknown and makes no edge.

    Args:
        depth: (H, W) [m] along the optical axis.
        brightness: what else the depth camera saw in the same pixels, such as reflectance, (H, W).

    Raises:
        CameraError: `depth` or `brightness` and the intrinsics disagree.
    """
    camera.check_image(depth, "depth image")
    depth = np.asarray(depth, np.float32)
    unknown = ~(depth > 0)
    z = ndimage.median_filter(np.where(unknown, np.inf, depth), 3)
    unknown = ndimage.binary_dilation(unknown, np.ones((3, 3)))
    uv, near = [], []
    for axis, half in ((1, [0.5, 0.0]), (0, [0.0, 0.5])):
        first, second = (np.take(z, range(s, z.shape[axis] - 1 + s), axis) for s in (0, 1))
        hidden = [np.take(unknown, range(s, z.shape[axis] - 1 + s), axis) for s in (0, 1)]
        far = np.maximum(first, second)
        with np.errstate(invalid="ignore"):
            limit = min_jump + jump_per_z2 * np.where(np.isfinite(far), far, 0) ** 2
            jump = (np.abs(first - second) > limit) & ~hidden[0] & ~hidden[1]
        v, u = np.nonzero(jump)
        uv.append(np.column_stack([u, v]) + half)
        near.append(np.minimum(first, second)[v, u])
    points = _straight_points(np.vstack(uv), np.concatenate(near).astype(float), camera)
    if brightness is None:
        return points
    camera.check_image(brightness, "brightness")
    edges = image_edges(np.where(np.isfinite(brightness), brightness, 0), 1.0)
    at = np.rint(edges.uv).astype(int)
    edge_z = z[at[:, 1], at[:, 0]].astype(float)
    # Next to a depth edge it is not clear whose border it is.
    flat = ndimage.maximum_filter(np.minimum(z, 1e3), 5) - ndimage.minimum_filter(z, 5) < min_jump + jump_per_z2 * z**2
    good = np.isfinite(edge_z) & flat[at[:, 1], at[:, 0]] & ~unknown[at[:, 1], at[:, 0]]
    borders = _straight_points(edges.uv[good], edge_z[good], camera)
    start = points.group.max(initial=-1) + 1
    return SpaceEdges(
        np.vstack([points.p_DP, borders.p_DP]),
        np.vstack([points.t_DP, borders.t_DP]),
        np.concatenate([points.group, borders.group + start]),
    )


def image_edges(image: np.ndarray, blur_px: float, noise_factor: float = 6.0) -> ImageEdges:
    """Pixels where the gradient of the blurred image is largest along its own direction, and above the noise.

    The noise is estimated from the image itself (Immerkær, Fast noise variance estimation, CVIU 1996, with a median);
    its share in the gradient, times `noise_factor`, is how much the gradient has to exceed that beside the edge, so
    that slow shading is none. The place between pixels is that of a parabola through three values along the gradient.
    """
    image = np.asarray(image, float)
    du, dv = (ndimage.gaussian_filter(image, blur_px, order=o, mode="nearest") for o in ((0, 1), (1, 0)))
    size = np.hypot(du, dv)
    mask = ndimage.convolve(image, np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]]), mode="nearest")
    # A whole number has an error of 0.29 even where the noise is smaller.
    noise = max(float(np.median(np.abs(mask))) / 0.6745 / 6, 0.02)
    threshold = noise_factor * noise / (blur_px**2 * np.sqrt(8 * np.pi))
    # A frame as wide as the blur is left out: what is beyond it is not known.
    margin = int(np.ceil(2 * blur_px)) + 1
    inner = np.zeros(image.shape, bool)
    inner[margin:-margin, margin:-margin] = True
    v, u = np.nonzero((size > threshold) & inner)
    normal = np.column_stack([du[v, u], dv[v, u]]) / size[v, u, None]
    beside = np.array([-2.5 * blur_px, -1, 1, 2.5 * blur_px])[:, None]
    before, low, high, after = ndimage.map_coordinates(
        size, [v + beside * normal[:, 1], u + beside * normal[:, 0]], order=1, mode="nearest"
    )
    middle = size[v, u]
    peak = (middle >= low) & (middle > high) & (middle - (before + after) / 2 > threshold)
    u, v, normal, low, high, middle = u[peak], v[peak], normal[peak], low[peak], high[peak], middle[peak]
    offset = 0.5 * (high - low) / (2 * middle - low - high)
    return ImageEdges(np.column_stack([u, v]) + np.clip(offset, -1, 1)[:, None] * normal, normal)


def _straight_points(uv: np.ndarray, z: np.ndarray, camera: CameraModel) -> SpaceEdges:
    """Points of edge pixels (N, 2) at depths (N,) that have enough neighbours on a straight line."""
    count = len(uv)
    if count < _NEIGHBOURS:
        return SpaceEdges(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, int))
    # Neighbours in depth as well: 10 % of it is as far as 5 pixels.
    place = np.column_stack([uv, 50 * np.log(z)])
    distance, neighbour = cKDTree(place).query(place, _NEIGHBOURS, distance_upper_bound=_REACH)
    inside = np.isfinite(distance)
    enough = inside.sum(axis=1) >= _NEIGHBOURS - 4
    neighbour = np.where(inside, neighbour, np.arange(count)[:, None])
    weight = inside / inside.sum(axis=1, keepdims=True)
    centre = np.einsum("nk,nki->ni", weight, uv[neighbour])
    offset = uv[neighbour] - centre[:, None]
    values, axes = np.linalg.eigh(np.einsum("nk,nki,nkj->nij", weight, offset, offset))
    straight = enough & (values[:, 0] < _STRAIGHT**2) & (values[:, 1] > 9 * values[:, 0])
    along = axes[:, :, 1]
    on_line = centre + ((uv - centre) * along).sum(axis=1, keepdims=True) * along
    mean_z = np.einsum("nk,nk->n", weight, z[neighbour])
    keep = np.flatnonzero(straight)
    uv, along, z = on_line[keep], along[keep], mean_z[keep]
    ends = [np.column_stack([camera.undistort(uv + s * along), np.ones(len(uv))]) * z[:, None] for s in (0, _LENGTH)]
    return SpaceEdges(ends[0], ends[1] - ends[0], _pieces(uv, along))


def _pieces(uv: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Number of the straight piece of every pixel: neighbours with nearly the same direction hang together."""
    angle = 2 * np.arctan2(along[:, 1], along[:, 0])
    # 10 degrees between neighbours are as far as 3 pixels.
    place = np.column_stack([uv, 8.6 * np.cos(angle), 8.6 * np.sin(angle)])
    pairs = cKDTree(place).query_pairs(3.0, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(uv), len(uv)))
    return np.asarray(connected_components(graph, directed=False)[1])
