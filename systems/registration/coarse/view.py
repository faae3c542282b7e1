"""One scan made ready for a search without a guess: levelled, seen from above, and with the air that it saw through."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import open3d as o3d
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform, RotationMatrix
from scipy.ndimage import minimum_filter

from ...clouds import transform_points, voxel_filter
from ...config import check_config, quantity
from .columns import Columns, find_columns
from .floor import find_floor
from .view_kernels import nearest_cells, range_image

# With this share of the ground under it, a floor is believed without looking for another.
WELL_SUPPORTED = 0.4


@dataclass(kw_only=True)
class ViewConfig:
    """How a scan is levelled and thinned, and what in it counts as floor, as raised and as seen through."""

    # [m] One mean point a voxel is kept.
    voxel: float = quantity(0.1, unit="m", above=0)
    # [m] Edge of the columns in which the scan is seen from above.
    cell: float = quantity(0.2, unit="m", above=0)
    # [m] Heights over the floor at which walls and objects are compared.
    heights: list[float] = quantity([0.2, 2.0], unit="m")
    # [m] Farthest point that takes part; a ring of a VLP-16 is 0.7 m from the next at 20 m.
    max_range: float = quantity(20.0, unit="m", above=1)
    # [deg] Most that the floor may lean against z, against z when so little of it is seen that one is searched that is
    # better supported (a hand-held scanner), and against the up where it is given.
    max_tilt_deg: float = quantity(12.0, unit="deg", above=0, high=45)
    max_wide_tilt_deg: float = quantity(45.0, unit="deg", above=0, high=60)
    max_up_error_deg: float = quantity(1.0, unit="deg", above=0, high=45)
    # [m] Points this near to its plane belong to the floor.
    floor_distance: float = quantity(0.06, unit="m", above=0)
    # [columns] Fewer are not searched.
    min_columns: int = quantity(60, unit="columns", low=10)
    # [deg] Pixel of the range image that says what was seen through.
    ray_angle_deg: float = quantity(1.0, unit="deg", above=0, high=10)
    # [m] How far from a surface the nearest column is still known, for the refinement.
    reach: float = quantity(0.8, unit="m", above=0)


class View:
    """A scan S, levelled: frame L has z up, the floor at z = 0 and the point from which S was seen on its z axis.

    Read-only, and to be made once for many comparisons. A `class_probabilities` layer of the cloud, (N, K), is kept.

    Attributes:
        X_LS: pose of the scan in its levelled frame.
        has_floor: whether the floor was found; without it the level is the given up (or z), and z = 0 the lowest point.
        raised: points (N, 3) between `heights` over the floor, one for each 0.2 m [m, in L].
        columns: the same from above, `Columns`.
        raised_column: column of each of `raised`, (N,).
        floor: what lies on the floor, likewise; empty when the floor was not found.
        p_LV: point from which the scan was seen [m], or None: then nothing is known about free space.
        problem: why it cannot be searched, or "".
    """

    def __init__(
        self,
        cloud: PointCloud,
        config: ViewConfig | None = None,
        *,
        up: np.ndarray | None = None,
        seen_from: np.ndarray | tuple[float, float, float] | None = (0.0, 0.0, 0.0),
    ):
        """Makes a view of `cloud` (points in S; what is not finite is left out).

        Args:
            up: direction against gravity in S, (3,), when an IMU knows it; else it is found from the floor.
            seen_from: where the sensor was, in S [m]; None for a merged cloud, which was seen from everywhere.
        """
        self.config = config = config or ViewConfig()
        check_config(config)
        self.X_LS = RigidTransform()
        self.has_floor = False
        self.p_LV = None if seen_from is None else np.asarray(seen_from, float)
        self.problem = ""
        everything = _finite(cloud)
        thinned = voxel_filter(everything, config.voxel) if len(everything.point.positions) else everything
        self._level(thinned.point.positions.numpy().astype(float), up)
        X = self.X_LS.GetAsMatrix4()
        self._everything = transform_points(X, everything.point.positions.numpy().astype(float))
        points, classes = transform_points(X, thinned.point.positions.numpy().astype(float)), _classes(thinned)
        height, distance = points[:, 2], np.hypot(points[:, 0], points[:, 1])
        near = distance < config.max_range
        raised = near & (height > config.heights[0]) & (height < config.heights[1])
        self.columns: Columns = find_columns(points[raised], self.p_LV, config.cell, classes[raised])
        on_floor = near & (np.abs(height) < 2 * config.floor_distance) & self.has_floor
        self.floor: Columns = find_columns(points[on_floor], self.p_LV, config.cell, classes[on_floor])
        self.raised, self.raised_column = self.columns.thin(points[raised])
        if len(self.columns.centres) < config.min_columns:
            self.problem = f"{len(self.columns.centres)} columns of walls and objects, needs {config.min_columns}"

    def __deepcopy__(self, memo: dict) -> "View":
        return self

    @property
    def tilt(self) -> float:
        """Angle of the scan's z axis against the vertical [rad]."""
        return float(np.arccos(np.clip(self.X_LS.rotation().matrix()[2, 2], -1, 1)))

    @cached_property
    def clear_range(self) -> np.ndarray:
        """Distance up to which the view saw through, by elevation and azimuth in L [m]; 0 where it saw nothing.

        It is the least over a pixel and its neighbours, so that no edge looks as if it were seen through.
        """
        step = np.deg2rad(self.config.ray_angle_deg)
        rows, columns = round(np.pi / step), round(2 * np.pi / step)
        if self.p_LV is None:
            return np.zeros((rows, columns))
        image = range_image(self._everything, self.p_LV, rows, columns)
        image = minimum_filter(image, 3, mode=("nearest", "wrap"))
        return np.ascontiguousarray(np.where(np.isfinite(image), image, 0.0))

    @cached_property
    def nearest(self) -> tuple[np.ndarray, np.ndarray]:
        """Index of the column nearest to each cell of 0.1 m within `reach`, −1 if none, and the table's corner [m]."""
        return nearest_cells(self.columns.centres, self.config.cell / 2, self.config.reach)

    @cached_property
    def nearest_floor(self) -> tuple[np.ndarray, np.ndarray]:
        """As `nearest`, of the floor's columns, within 0.3 m."""
        return nearest_cells(self.floor.centres, self.config.cell / 2, 0.3)

    def _level(self, points: np.ndarray, up: np.ndarray | None) -> None:
        axis = np.array([0.0, 0.0, 1.0]) if up is None else np.asarray(up, float) / np.linalg.norm(up)
        p_SV, near = self.p_LV, self.config.floor_distance
        limit = np.deg2rad(self.config.max_tilt_deg if up is None else self.config.max_up_error_deg)
        plane = find_floor(points, axis, p_SV, limit, near)
        if up is None and (plane is None or plane[2] < WELL_SUPPORTED):
            # A hand-held scanner: a rough floor at any slope says where the lowest points are, and these say it well.
            rough = find_floor(points, axis, p_SV, np.deg2rad(self.config.max_wide_tilt_deg), near)
            wide = None if rough is None else find_floor(points, rough[0], p_SV, limit, near)
            if wide is not None and (plane is None or wide[2] > 1.2 * plane[2]):
                plane = wide
        if plane is not None:
            axis, height, _ = plane
            self.has_floor = True
        else:
            height = float(np.percentile(points @ axis, 1)) if len(points) else 0.0
        R = RotationMatrix.ProjectToRotationMatrix(_without_yaw(axis))
        origin = np.zeros(3) if p_SV is None else R.matrix() @ p_SV
        self.X_LS = RigidTransform(R, np.array([-origin[0], -origin[1], -height]))
        if p_SV is not None:
            self.p_LV = np.array([0.0, 0.0, origin[2] - height])


def _without_yaw(up: np.ndarray) -> np.ndarray:
    """The rotation that takes `up` to z by the shortest way."""
    cosine = float(up[2])
    if cosine < -0.999:
        return np.diag([1.0, -1.0, -1.0])
    x, y, z = np.cross(up, [0.0, 0.0, 1.0])
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + K + K @ K / (1 + cosine))


def _finite(cloud: PointCloud) -> PointCloud:
    """Positions and class probabilities of the points that are finite."""
    points = cloud.point.positions.numpy() if "positions" in cloud.point else np.zeros((0, 3))
    finite = np.isfinite(points).all(axis=1)
    kept = PointCloud(o3d.core.Tensor(np.ascontiguousarray(points[finite], np.float32)))
    if "class_probabilities" in cloud.point:
        layer = cloud.point["class_probabilities"].numpy()[finite]
        kept.point["class_probabilities"] = o3d.core.Tensor(np.ascontiguousarray(layer, np.float32))
    return kept


def _classes(cloud: PointCloud) -> np.ndarray:
    """(N, K); K = 0 without classes."""
    if "class_probabilities" not in cloud.point:
        return np.zeros((len(cloud.point.positions), 0))
    return cloud.point["class_probabilities"].numpy().astype(float)
