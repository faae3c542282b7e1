"""Finds how two level views of one place lie to each other, without any initial guess."""

from dataclasses import dataclass, field

import numpy as np
import scipy.fft
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform, RollPitchYaw
from scipy.ndimage import gaussian_filter

from ..config import quantity
from .joint_registration import JointRegistrationConfig, register_jointly
from .viewpoint import Viewpoint, ViewpointConfig

# Pixels along the edge of the squares of which only the highest value of the correlation counts.
BLOCK = 4


def _quick() -> JointRegistrationConfig:
    return JointRegistrationConfig(stride=4, max_distances=[0.6, 0.2, 0.06], max_iterations=6, tolerance=1e-3)


@dataclass(kw_only=True)
class PlaceSearchConfig:
    """How the pose of one view in another is searched."""

    view: ViewpointConfig = field(default_factory=ViewpointConfig)
    # [m] Pixel of the bird's-eye images.
    pixel: float = quantity(0.2, unit="m", above=0)
    # [deg] Step of the yaws that are tried; half of it moves a wall at 10 m by a pixel and a half.
    yaw_step_deg: float = quantity(3.0, unit="deg", above=0, high=30)
    # [m] Farthest point that takes part in the search.
    max_range: float = quantity(25.0, unit="m", above=0)
    # [-] What a raised point in the other view's free space costs against one on its walls, in the images.
    image_penalty: float = quantity(0.3, unit="-", low=0)
    # [-] The same, in the score of a refined pose.
    penalty: float = quantity(5.0, unit="-", low=0)
    # Peaks of the correlation that are refined.
    peaks: int = quantity(4, unit="peaks", low=1)
    # [m], [deg] Poses nearer to each other than this are one.
    same_distance: float = quantity(0.5, unit="m", above=0)
    same_angle_deg: float = quantity(5.0, unit="deg", above=0)
    # How every peak is refined.
    refinement: JointRegistrationConfig = field(default_factory=_quick)


@dataclass(frozen=True, eq=False)
class PlaceCandidate:
    """A pose that one view may have in another.

    Attributes:
        X_TS: pose of the source in the target.
        score: mean over both directions of agreed − penalty · denied, see `Agreement`; at most 1.
        agreed: share of the raised points that lie on what the other view saw, mean of both directions.
        denied: share that lie where the other view saw only air, mean of both directions.
        fitness: share of all points that found a partner, of both views; `rmse`: weighted root mean square distance of
            these to the planes of their partners [m].
    """

    X_TS: RigidTransform
    score: float
    agreed: float
    denied: float
    fitness: float
    rmse: float

    def __deepcopy__(self, memo: dict) -> "PlaceCandidate":
        return self


def find_pose(
    source: PointCloud, target: PointCloud, config: PlaceSearchConfig | None = None
) -> tuple[PlaceCandidate, ...]:
    """Poses X_TS that lay `source` on `target`, best first; empty when a view cannot be used or nothing fits.

    Both are level, z up, and were taken from their origins; yaw and position are not known at all. See `search_place`.
    """
    config = config or PlaceSearchConfig()
    return search_place(Viewpoint(source, config.view), Viewpoint(target, config.view), config)


def search_place(
    source: Viewpoint, target: Viewpoint, config: PlaceSearchConfig | None = None
) -> tuple[PlaceCandidate, ...]:
    """Poses X_TS that may lay `source` on `target`, distinct and best first.

    1. Bird's-eye images of what stands on the floor, and of the free floor between it and the viewpoint, are
       correlated at all shifts (by FFT) and yaws: raised on raised counts for a pose, raised on free against it.
    2. The highest peaks that are not the same pose are refined by point-to-plane registration in both directions; what
       leans afterwards is dropped, since both views are level.
    3. A pose is scored by what both views say about each other's points, see `Viewpoint.agreement`. That is what tells
       a rectangular hall from itself turned by 180°: the walls fit both ways, what stands inside only one way.

    Two candidates with nearly one score mean that the views alone do not tell which is right.
    """
    config = config or PlaceSearchConfig()
    if source.problem or target.problem:
        return ()
    found: list[PlaceCandidate] = []
    for X_guess in _peaks(source, target, config):
        poses = {0: RigidTransform(), 1: X_guess}
        result = register_jointly({0: target, 1: source}, poses, [(0, 1)], config.refinement)
        X_TS = result.poses[1]
        lean = float(np.arccos(np.clip(X_TS.rotation().matrix()[2, 2], -1, 1)))
        if lean < np.deg2rad(config.view.max_tilt_deg):
            fitness = result.pairs * config.refinement.stride / (len(source.points) + len(target.points))
            found.append(judge(source, target, X_TS, config, fitness, result.rmse))
    found.sort(key=lambda candidate: -candidate.score)
    return tuple(_distinct(found, config))


def judge(
    source: Viewpoint,
    target: Viewpoint,
    X_TS: RigidTransform,
    config: PlaceSearchConfig,
    fitness: float = 0.0,
    rmse: float = float("inf"),
) -> PlaceCandidate:
    """Scores the pose X_TS by what both views say."""
    a, b = target.agreement(source, X_TS), source.agreement(target, X_TS.inverse())
    agreed, denied = (a.agreed + b.agreed) / 2, (a.denied + b.denied) / 2
    return PlaceCandidate(X_TS, agreed - config.penalty * denied, agreed, denied, fitness, rmse)


def same_pose(X: RigidTransform, Y: RigidTransform, config: PlaceSearchConfig, factor: float = 1.0) -> bool:
    """Whether two poses are nearer to each other than `same_distance` and `same_angle_deg`, times `factor`."""
    distance = float(np.linalg.norm(X.translation() - Y.translation()))
    angle = abs((X.rotation().inverse() @ Y.rotation()).ToAngleAxis().angle())
    return distance < factor * config.same_distance and angle < factor * np.deg2rad(config.same_angle_deg)


def _distinct(candidates: list[PlaceCandidate], config: PlaceSearchConfig) -> list[PlaceCandidate]:
    kept: list[PlaceCandidate] = []
    for candidate in candidates:
        if not any(same_pose(candidate.X_TS, other.X_TS, config) for other in kept):
            kept.append(candidate)
    return kept


def _peaks(source: Viewpoint, target: Viewpoint, config: PlaceSearchConfig) -> list[RigidTransform]:
    """Guesses X_TS at the highest peaks of the correlation, in falling order."""
    raised_T, raised_S = (_within(view.raised[:, :2], config.max_range) for view in (target, source))
    if len(raised_T) == 0 or len(raised_S) == 0:
        return []
    free_T, free_S = (_free_points(view, raised, config) for view, raised in ((target, raised_T), (source, raised_S)))
    # Images are centred on the origins, large enough that no shift wraps around.
    reach = sum(float(np.linalg.norm(points, axis=1).max()) for points in (raised_T, raised_S))
    size = BLOCK * scipy.fft.next_fast_len(int(2 * reach / config.pixel / BLOCK) + 2)
    image = gaussian_filter(_image(raised_T, size, config.pixel), 1.5, mode="wrap", truncate=2.0)
    clear = _image(free_T, size, config.pixel)
    for_raised = scipy.fft.rfft2(image - config.image_penalty * clear * (image == 0))
    for_free = -config.image_penalty * scipy.fft.rfft2(image)
    peaks = [np.zeros((0, 4))]
    for yaw in np.deg2rad(np.arange(0.0, 360.0, config.yaw_step_deg)):
        R = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        raised = scipy.fft.rfft2(_image(raised_S @ R.T, size, config.pixel))
        free = scipy.fft.rfft2(_image(free_S @ R.T, size, config.pixel))
        values = scipy.fft.irfft2(for_raised * raised.conj() + for_free * free.conj(), (size, size))
        peaks.append(_highest(values, yaw, config))
    heights = np.vstack(peaks)
    dz = target.floor - source.floor
    dz = float(dz) if np.isfinite(dz) else 0.0
    guesses: list[RigidTransform] = []
    for _, yaw, x, y in heights[np.argsort(-heights[:, 0])]:
        X = RigidTransform(RollPitchYaw(0, 0, yaw), np.array([x, y, dz]))
        # Two starts for one peak cost a registration each and end at one pose.
        if not any(same_pose(X, other, config, factor=2.0) for other in guesses):
            guesses.append(X)
            if len(guesses) == config.peaks:
                break
    return guesses


def _highest(values: np.ndarray, yaw: float, config: PlaceSearchConfig) -> np.ndarray:
    """The highest values of the correlation at one yaw, at most one a block: rows of value, yaw, x, y."""
    count, blocks = 2 * config.peaks, len(values) // BLOCK
    tiles = values.reshape(blocks, BLOCK, blocks, BLOCK).transpose(0, 2, 1, 3).reshape(-1, BLOCK * BLOCK)
    best = tiles.max(axis=1)
    top = np.argpartition(-best, count)[:count]
    inside = tiles[top].argmax(axis=1)
    rows, columns = top // blocks * BLOCK + inside // BLOCK, top % blocks * BLOCK + inside % BLOCK
    shifts = np.column_stack([rows, columns])
    shifts = np.where(shifts > len(values) // 2, shifts - len(values), shifts) * config.pixel
    return np.column_stack([best[top], np.full(len(top), yaw), shifts])


def _image(points: np.ndarray, size: int, pixel: float) -> np.ndarray:
    index = np.round(points / pixel).astype(int) % size
    image = np.zeros((size, size), np.float32)
    image[index[:, 0], index[:, 1]] = 1
    return image


def _free_points(view: Viewpoint, raised: np.ndarray, config: PlaceSearchConfig) -> np.ndarray:
    """Places (K, 2) on the way from the viewpoint to the nearest raised point of each direction, one a pixel."""
    ray = raised - view.p_VS[:2]
    distance = np.linalg.norm(ray, axis=1)
    column = ((np.arctan2(ray[:, 1], ray[:, 0]) + np.pi) / np.deg2rad(1.0)).astype(int) % 360
    nearest = np.full(360, 0.0)
    order = np.argsort(-distance)
    nearest[column[order]] = distance[order]  # the nearest is written last
    steps = np.arange(config.pixel, max(float(distance.max()), config.pixel), config.pixel)
    angle = np.deg2rad(np.arange(360) + 0.5) - np.pi
    places = view.p_VS[:2] + steps[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return places[steps[:, None] < nearest - 2 * config.pixel]


def _within(points: np.ndarray, reach: float) -> np.ndarray:
    return points[np.linalg.norm(points, axis=1) < reach]
