"""Points get what cameras saw of them: one view at a time, added to what earlier views gave."""

from dataclasses import dataclass, field

import numpy as np
from pydrake.math import RigidTransform

from ..config import quantity
from ..sensing.camera_model import CameraModel
from .camera_view import CameraView, LampConfig
from .projection import move_rows, project_rows, sample
from .visibility import VisibilityConfig, visible


@dataclass(kw_only=True)
class PaintConfig:
    """Which points a view paints, and how much it counts."""

    # [m] Points farther from the camera are not painted; nor are those farther from the lamp.
    max_range: float = quantity(10.0, unit="m", above=0)
    # [m] Distance at which a view counts half as much as from very near.
    half_range: float = quantity(2.0, unit="m", above=0)
    # [-] Smallest cosine of incidence, of camera and lamp, that is reckoned with: 87 degrees. Grazing light says little
    # of a surface; without the bound an error of its normal would make it white.
    min_cos: float = quantity(0.05, unit="-", above=0, high=1)
    # [-] Cosine of incidence of a surface whose normal is not known: the mean over all directions it may face.
    unknown_cos: float = quantity(0.5, unit="-", above=0, high=1)
    # [-] What a view of a surface with unknown normal counts against one with a known normal; with 0 it is not painted.
    unknown_weight: float = quantity(0.2, unit="-", low=0, high=1)
    # What hides points from camera and lamp.
    visibility: VisibilityConfig = field(default_factory=VisibilityConfig)


@dataclass(frozen=True, eq=False)
class Paint:
    """Weighted sums over all views so far, one entry a point: a new view is added without going back to earlier ones.

    Attributes:
        weight: sum of the weights, (N,) float32; 0 where a point was never seen.
        value_sum, range_sum: weighted sums of value and of distance to the camera, (N,) float32.
        newly: points that the last view painted.
        reason: why the last view painted nothing, else "".
    """

    weight: np.ndarray
    value_sum: np.ndarray
    range_sum: np.ndarray
    newly: int = 0
    reason: str = ""

    @staticmethod
    def none(points: int) -> "Paint":
        """What `points` points have before the first view."""
        return Paint(*np.zeros((3, points), np.float32))

    def __deepcopy__(self, memo: dict) -> "Paint":
        return self

    @property
    def value(self) -> np.ndarray:
        """Weighted mean of what the views saw, (N,) float32, NaN where never seen."""
        return _mean(self.value_sum, self.weight)

    @property
    def range(self) -> np.ndarray:
        """Weighted mean distance at which it was seen [m], (N,) float32, NaN where never seen."""
        return _mean(self.range_sum, self.weight)

    @property
    def painted(self) -> float:
        """Part of the points that were seen, [0, 1]."""
        return float((self.weight > 0).mean()) if len(self.weight) else 0.0


def _mean(total: np.ndarray, weight: np.ndarray) -> np.ndarray:
    return np.divide(total, weight, out=np.full(len(weight), np.nan, np.float32), where=weight > 0)


def paint(
    p_BP: np.ndarray,
    normals: np.ndarray | None,
    X_OB: RigidTransform,
    view: CameraView,
    camera: CameraModel,
    config: PaintConfig | None = None,
    *,
    lamp: LampConfig | None = None,
    occluders: tuple[np.ndarray, np.ndarray | None] | None = None,
    before: Paint | None = None,
) -> Paint:
    """Adds one view to what is known of every point.

    Between the instants of cloud and image the base moved from B to B′, which the odometry tells: the camera in B is
    X_BO X_OB′ X_B′C. Points are projected (`project`, Eq. 1), those that are hidden from the camera left out
    (`visible`), and the image sampled (`sample`).

    A view counts with the weight w = cos θ / (1 + d²/h²) · (1 − ρ²)². θ is the incidence at the surface and d the
    distance; cos θ / d² is how many pixels see a piece of the surface, held finite near by (`half_range` h). ρ is the
    distance from the middle of the image, 1 in its corners: views fade out towards their edges, so that there are no
    seams where they overlap (feathering: Szeliski, Image Alignment and Stitching, 2006, section 6.2); at least 1 %, so
    that a corner that nobody else saw is painted.

    With a lamp, values are radiances L and points get the reflectance ρ of a diffuse surface, L = ρ (E0 cos θ_L / r² +
    E_a), with the incidence θ_L and distance r of the lamp, which moves with the robot, and the ambient light E_a.
    Points outside of its cone or in its shadow get nothing. A normal that is not known counts as `unknown_cos`.

    Args:
        p_BP: points in B at the time of the cloud, (N, 3) [m].
        normals: unit normals in B, (N, 3), zero where unknown, of either sign; None for all unknown.
        X_OB: odometry at the time of the cloud, in the O of the view.
        lamp: where it is in B′, at the time of the view.
        occluders: points and normals (or None) in B that can hide points; the points themselves when not given.
        before: what to add to; nothing when not given.
    """
    config = config or PaintConfig()
    points = np.asarray(p_BP, np.float32).reshape(-1, 3)
    fresh = before is None
    before = before or Paint.none(len(points))
    if not view.known:
        return _unchanged(before, "no pixel of the image says anything")
    X_BV = X_OB.inverse() @ view.X_OB
    X_BC = X_BV @ view.X_BC
    X_CB = X_BC.inverse()
    p_CP = move_rows(points, X_CB.rotation().matrix(), X_CB.translation())
    index, uv, _ = project_rows(p_CP, camera, config.max_range)
    if len(index) == 0:
        return _unchanged(before, "the camera looks away from the cloud")
    values = sample(view.values, uv)
    kept = np.isfinite(values)
    p_BL = None
    if lamp is not None:
        p_BL = X_BV.multiply(np.array(lamp.p_BL, float))
        kept &= _in_cone(points[index], p_BL, X_BV.rotation().multiply(np.array(lamp.axis_B, float)), lamp, config)
    index, uv, values = index[kept], uv[kept], values[kept]
    eyes = [X_BC.translation()] + ([] if p_BL is None else [p_BL])
    if occluders is None:
        between = _between(p_CP, index, [X_CB.multiply(eye) for eye in eyes])
        occluders = points[between], None if normals is None else normals[between]
    seen = _seen_by_all(eyes, points, normals, index, occluders, config.visibility)
    index, uv, values = index[seen], uv[seen], values[seen]
    if len(index) == 0:
        return _unchanged(before, "no point is in the light and not hidden, where a pixel says something")
    n = np.zeros((len(index), 3), np.float32) if normals is None else np.asarray(normals[index], np.float32)
    distance, cosine = _incidence(points[index], X_BC.translation(), n, config)
    if lamp is not None and p_BL is not None:
        r, lamp_cosine = _incidence(points[index], p_BL, n, config)
        values = values / (np.float32(lamp.intensity) * lamp_cosine / (r * r) + np.float32(lamp.ambient))
    weight = _weight(uv, distance, cosine, camera, config)
    weight[_unknown(n)] *= np.float32(config.unknown_weight)

    def added(total: np.ndarray, more: np.ndarray) -> np.ndarray:
        total = total if fresh else total.copy()
        total[index] += more
        return total

    sums = (
        added(before.weight, weight),
        added(before.value_sum, weight * values),
        added(before.range_sum, weight * distance),
    )
    return Paint(*sums, len(index), "")


def _seen_by_all(
    eyes: list[np.ndarray],
    points: np.ndarray,
    normals: np.ndarray | None,
    index: np.ndarray,
    occluders: tuple[np.ndarray, np.ndarray | None],
    config: VisibilityConfig,
) -> np.ndarray:
    """Places in `index` of those that are hidden from no eye. One that is hidden from an eye is not asked the next."""
    hiding, hiding_normals = occluders
    left = np.arange(len(index))
    for eye in eyes:
        asked = index[left]
        seen = visible(
            points[asked],
            eye,
            normals=None if normals is None else normals[asked],
            occluders=hiding,
            occluder_normals=hiding_normals,
            config=config,
        )
        left = left[seen]
    return left


def _weight(
    uv: np.ndarray, distance: np.ndarray, cosine: np.ndarray, camera: CameraModel, config: PaintConfig
) -> np.ndarray:
    """What a view counts for points at pixels (n, 2), see `paint`, (n,) float32."""
    middle = np.array([camera.width - 1, camera.height - 1], np.float32) / 2
    from_middle = np.square((uv - middle) / (middle + 0.5)) @ np.array([0.5, 0.5], np.float32)
    weight: np.ndarray = cosine / (1 + np.square(distance / np.float32(config.half_range)))
    weight *= np.maximum(np.square(1 - from_middle), np.float32(0.01))
    return weight


def _between(p_CP: np.ndarray, index: np.ndarray, eyes_C: list[np.ndarray]) -> np.ndarray:
    """Index of the points that can hide those at `index`: in the box around them and the eyes, and a little more."""
    if len(index) == 0:
        return index
    inside = np.ones(p_CP.shape[1], bool)
    margin = 0.08 * float(p_CP[2, index].max())
    for row, at in zip(p_CP, np.transpose(eyes_C), strict=True):
        low, high = min(at.min(), row[index].min()) - margin, max(at.max(), row[index].max()) + margin
        inside &= (row >= np.float32(low)) & (row <= np.float32(high))
    return np.flatnonzero(inside)


def _unchanged(before: Paint, reason: str) -> Paint:
    return Paint(before.weight, before.value_sum, before.range_sum, 0, reason)


def _unknown(normals: np.ndarray) -> np.ndarray:
    return (normals[:, 0] == 0) & (normals[:, 1] == 0) & (normals[:, 2] == 0)


def _incidence(
    points: np.ndarray, eye: np.ndarray, normals: np.ndarray, config: PaintConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Distance to the eye [m] and cosine of incidence, bounded from below, (N,) float32 each."""
    to_eye = np.asarray(eye, np.float32) - points
    distance = np.maximum(np.sqrt(np.einsum("ij,ij->i", to_eye, to_eye)), np.float32(1e-3))
    cosine = np.abs(np.einsum("ij,ij->i", to_eye, normals)) / distance
    cosine = np.where(_unknown(normals), np.float32(config.unknown_cos), cosine)
    return distance, np.maximum(cosine, np.float32(config.min_cos))


def _in_cone(
    points: np.ndarray, p_BL: np.ndarray, axis_B: np.ndarray, lamp: LampConfig, config: PaintConfig
) -> np.ndarray:
    from_lamp = points - np.asarray(p_BL, np.float32)
    distance = np.sqrt(np.einsum("ij,ij->i", from_lamp, from_lamp))
    along = from_lamp @ np.asarray(axis_B / np.linalg.norm(axis_B), np.float32)
    return (along >= distance * np.float32(np.cos(lamp.half_angle))) & (distance <= config.max_range)
