"""What a laser tells of the robot's pose along its ways, and how far off it may be there: the low fidelity of ours.

The Fisher information of a scan bounds what any matcher can do with it (Censi 2007); between scans the error grows by
the odometry's.
"""

from dataclasses import dataclass

import numpy as np

from ..config import check_config, quantity
from .floor_plan import FloorPlan
from .information_kernels import scan_information
from .landmarks import reachable_cells
from .wall_kernels import wall_directions, wall_faces


@dataclass(kw_only=True)
class InformationConfig:
    """The laser and the odometry, as far as the error of a pose depends on them."""

    # [rad] Field of view, [m] range to which ranges are used for localisation (the paper's 15 m), [rad] between rays.
    field_of_view: float = quantity(4.712389, unit="rad", above=0, high=6.2832)
    used_range: float = quantity(15.0, unit="m", above=0)
    ray_spacing: float = quantity(0.00436332, unit="rad", above=0)
    # [rad] Between the rays that are cast to see what walls tell; boxes are met by every ray.
    cast_spacing: float = quantity(0.0349066, unit="rad", above=0)
    # [m] Standard deviation of a range, and of where the map's walls are: its cells.
    range_noise: float = quantity(0.03, unit="m", above=0)
    map_noise: float = quantity(0.05, unit="m", above=0)
    # [-] Share of the rays that tell something of their own: neighbours meet the same cells of the map.
    share: float = quantity(0.05, above=0, high=1)
    # [m] Between the poses along a way at which a scan is taken.
    step: float = quantity(1.0, unit="m", above=0)
    # Odometry: standard deviations [m/√m] along and across, [rad/√m] of the heading, [rad/√rad] when turning.
    odometry_position: float = quantity(0.03, unit="m/√m", low=0)
    odometry_heading: float = quantity(0.01, unit="rad/√m", low=0)
    odometry_turn: float = quantity(0.03, unit="rad/√rad", low=0)
    # [m], [rad] Standard deviations at the start.
    start_position: float = quantity(0.03, unit="m", above=0)
    start_heading: float = quantity(0.01, unit="rad", above=0)
    # [-] Standard deviations, along the worst direction, that are taken for the largest error.
    sigmas: float = quantity(3.0, above=0)

    def odometry(self) -> np.ndarray:
        """(4,) variances per metre along, per metre across, of the heading per metre, and per radian."""
        return (
            np.array(
                [self.odometry_position, self.odometry_position, self.odometry_heading, self.odometry_turn]
            ).astype(float)
            ** 2
        )


def scans_along(
    plan: FloorPlan, poses: np.ndarray, sites: np.ndarray, side: float, config: InformationConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Information of scans at `poses` (n, 3) in W, (n, 6), and what boxes at `sites` (k, 2) [m] add, (n, k, 6).

    See `scan_information`. Exact as to which walls each ray meets, and which box.

    Raises:
        ConfigError: a value of `config` is out of range.
    """
    check_config(config, key="information")
    directions, _ = wall_directions(
        wall_faces(plan.occupied, reachable_cells(plan)), max(2, round(0.3 / plan.resolution))
    )
    local = np.array(poses, float).reshape(-1, 3)
    local[:, :2] -= plan.origin
    laser = np.array([config.field_of_view, config.used_range, config.ray_spacing, config.cast_spacing])
    noise = np.array([config.range_noise, config.map_noise, config.share])
    corner = np.asarray(sites, float).reshape(-1, 2) - plan.origin
    return scan_information(plan.occupied, directions, plan.resolution, local, corner, side, laser, noise)


def full_matrix(info: np.ndarray) -> np.ndarray:
    """(..., 3, 3) matrices of upper triangles (..., 6)."""
    return np.asarray(info)[..., [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
