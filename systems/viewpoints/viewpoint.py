"""One view of a place, made ready to be laid on another, and how far two views agree at a pose."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import open3d as o3d
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform
from scipy.ndimage import minimum_filter
from scipy.spatial import KDTree

from ..clouds import estimate_normals, transform_points, voxel_filter
from ..config import quantity


@dataclass(kw_only=True)
class ViewpointConfig:
    """How a view is thinned, and what in it counts as floor, as raised and as seen through."""

    # [m] One mean point a voxel is kept for registration; and for the questions of agreement.
    voxel: float = quantity(0.1, unit="m", above=0)
    coarse_voxel: float = quantity(0.2, unit="m", above=0)
    # [m] Neighbourhood in which normals are estimated; wider than the gap between two rings of a VLP-16 at 10 m.
    normal_radius: float = quantity(0.75, unit="m", above=0)
    # [m] Heights over the floor at which walls and objects are compared.
    heights: list[float] = quantity([0.2, 2.0], unit="m")
    # [deg] Most that the floor may lean in a view that counts as level.
    max_tilt_deg: float = quantity(3.0, unit="deg", above=0, high=45)
    # [points] Least number of raised voxels in a view.
    min_points: int = quantity(200, unit="points", low=20)
    # [deg] Pixel of the range image that says what a view saw through.
    ray_angle_deg: float = quantity(1.0, unit="deg", above=0, high=10)
    # [m] A point of one view this near to one of the other agrees with it.
    agree_distance: float = quantity(0.25, unit="m", above=0)
    # [m] A point this much nearer than what the other view saw in its direction lies in space that it saw through.
    clear_margin: float = quantity(0.4, unit="m", above=0)


@dataclass(frozen=True, eq=False)
class Agreement:
    """What one view says about the raised points of another.

    Attributes:
        agreed: share of the points that lie on something that it saw.
        denied: share of them that lie where it saw nothing but air.

    The rest is hidden from it, or outside its field of view.
    """

    agreed: float
    denied: float

    @property
    def score(self) -> float:
        """Agreed share of what is not hidden, in [0, 1]; 0 when all of it is."""
        seen = self.agreed + self.denied
        return self.agreed / seen if seen > 0 else 0.0


class Viewpoint:
    """A level view V of a place: z up, seen from `p_VS`. Read-only.

    Attributes:
        points: thinned points (N, 3) [m]; `normals`: theirs, towards the viewpoint, zero where there is no plane.
        raised: thinned points (K, 3) [m] between `heights` over the floor; `raised_normals`: theirs.
        floor_plane: a, b, c of the floor z = a x + b y + c around the viewpoint, None when it was not found.
        floor: height of the floor at V's origin [m], nan when it was not found.
        tilt: angle of the floor against the level [rad], nan when it was not found.
        p_VS: where the view was taken from [m].
        problem: why the view cannot be used, or "".
    """

    def __init__(self, cloud: PointCloud, config: ViewpointConfig | None = None, p_VS: np.ndarray | None = None):
        config = config or ViewpointConfig()
        self.config = config
        self.p_VS = np.zeros(3) if p_VS is None else np.asarray(p_VS, float)
        everything = _finite(cloud)
        self._everything = everything
        self.points = _thin(everything, config.voxel)
        self.floor_plane: np.ndarray | None = None
        self.floor, self.tilt = float("nan"), float("nan")
        self.raised = self.raised_normals = np.zeros((0, 3))
        self.normals = np.zeros_like(self.points)
        self.problem = ""
        if len(self.points) < config.min_points:
            self.problem = f"{len(self.points)} usable voxels, needs {config.min_points}"
            return
        normals = estimate_normals(self.points, config.normal_radius)
        away = ((self.points - self.p_VS) * normals).sum(axis=1) > 0
        self.normals = np.where(away[:, None], -normals, normals)
        self.floor_plane = _find_floor(self.points, self.normals)
        if self.floor_plane is not None:
            a, b, self.floor = self.floor_plane.tolist()
            self.tilt = float(np.arctan(np.hypot(a, b)))
        low, high = config.heights
        base = self.floor if np.isfinite(self.floor) else float(np.percentile(self.points[:, 2], 1))
        height = self.points[:, 2] - base
        self.raised = _thin(self.points[(height > low) & (height < high)], config.coarse_voxel)
        self.raised_normals = self.normals[self.tree.query(self.raised)[1]] if len(self.raised) else self.raised
        if self.tilt > np.deg2rad(config.max_tilt_deg):
            self.problem = f"not level: its floor leans by {np.rad2deg(self.tilt):.1f} deg, give its roll and pitch"
        elif len(self.raised) < config.min_points:
            self.problem = f"{len(self.raised)} voxels of walls and objects, needs {config.min_points}"

    def __deepcopy__(self, memo: dict) -> "Viewpoint":
        return self

    @cached_property
    def tree(self) -> KDTree:
        """Of `points`."""
        return KDTree(self.points)

    @cached_property
    def clear_range(self) -> np.ndarray:
        """Distance up to which the view saw through, by elevation and azimuth [m]; 0 where it saw nothing.

        It is the least over a pixel and its neighbours, so that no edge looks as if it were seen through.
        """
        rows, columns, distance = self._pixels(self._everything)
        step = self.config.ray_angle_deg
        image = np.full((round(180 / step), round(360 / step)), np.inf)
        np.minimum.at(image, (rows, columns), distance)
        image = minimum_filter(image, 3, mode=("nearest", "wrap"))
        return np.where(np.isfinite(image), image, 0.0)

    def agreement(self, other: "Viewpoint", X_VO: RigidTransform) -> Agreement:
        """What this view says about the raised points of `other` (points in O) at the pose X_VO.

        The two faces of a wall do not agree with each other: a hall and the one next door share no surface.
        """
        points = transform_points(X_VO.GetAsMatrix4(), other.raised)
        if len(points) == 0:
            return Agreement(0.0, 0.0)
        apart, partner = self.tree.query(points, distance_upper_bound=self.config.agree_distance)
        near = np.isfinite(apart)
        normals = other.raised_normals[near] @ X_VO.rotation().matrix().T
        near[near] = (self.normals[partner[near]] * normals).sum(axis=1) > -0.5
        rows, columns, distance = self._pixels(points)
        through = distance < self.clear_range[rows, columns] - self.config.clear_margin
        return Agreement(float(near.mean()), float((through & ~near).mean()))

    def _pixels(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        ray = points - self.p_VS
        distance = np.linalg.norm(ray, axis=1)
        elevation = np.arcsin(np.clip(ray[:, 2] / np.maximum(distance, 1e-9), -1, 1))
        azimuth = np.arctan2(ray[:, 1], ray[:, 0])
        step = np.deg2rad(self.config.ray_angle_deg)
        rows, columns = round(np.pi / step), round(2 * np.pi / step)
        row = np.clip(((elevation + np.pi / 2) / step).astype(int), 0, rows - 1)
        return row, ((azimuth + np.pi) / step).astype(int) % columns, distance


def _finite(cloud: PointCloud) -> np.ndarray:
    if "positions" not in cloud.point:
        return np.zeros((0, 3))
    points = cloud.point.positions.numpy().astype(float)
    return points[np.isfinite(points).all(axis=1)]


def _thin(points: np.ndarray, voxel: float) -> np.ndarray:
    if len(points) == 0:
        return points
    thinned = voxel_filter(PointCloud(o3d.core.Tensor(points.astype(np.float32))), voxel)
    return thinned.point.positions.numpy().astype(float)


def _find_floor(points: np.ndarray, normals: np.ndarray) -> np.ndarray | None:
    """The plane z = a x + b y + c of the lowest large surface that is within 30° of level, None without one."""
    level = points[np.abs(normals[:, 2]) > np.cos(np.deg2rad(30))]
    if len(level) < 20:
        return None
    edges = np.arange(level[:, 2].min(), level[:, 2].max() + 0.4, 0.2)
    counts, _ = np.histogram(level[:, 2], edges)
    bottom = edges[int(np.argmax(counts >= 0.15 * counts.max()))]
    near = level[np.abs(level[:, 2] - bottom - 0.1) < 0.6]
    plane = np.zeros(3)
    for _ in range(10):  # trimmed plane z = a x + b y + c
        A = np.column_stack([near[:, :2], np.ones(len(near))])
        plane = np.linalg.lstsq(A, near[:, 2], rcond=None)[0]
        miss = np.abs(A @ plane - near[:, 2])
        near = near[miss <= max(float(np.percentile(miss, 85)), 0.03)]
        if len(near) < 20:
            return None
    return plane
