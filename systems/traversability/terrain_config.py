"""Where ground is looked at ahead of a robot, and how it is described (row S3-a)."""

from dataclasses import dataclass, field

import numpy as np

from ..config import quantity

FITS = ("robust", "least_squares")


@dataclass(kw_only=True)
class SurfaceConfig:
    """How the points over a cell of ground become its surface."""

    # [m] Edge of a cell.
    cell: float = quantity(0.1, unit="m", above=0)
    # [m] What is higher over the ground than this hangs above the robot.
    clearance: float = quantity(1.0, unit="m", above=0)
    # [m] Cells are compared with the next one that was seen, at most this far away.
    max_gap: float = quantity(0.3, unit="m", above=0)
    # [m] How much of a difference of height the noise of ranges and poses may make.
    noise: float = quantity(0.02, unit="m", low=0)
    # [deg] A difference of height across a gap counts as a step only in so far as it is steeper than this.
    gap_slope_deg: float = quantity(45.0, unit="deg", low=0, high=80)


@dataclass(kw_only=True)
class TerrainConfig:
    """Rectangles of ground ahead of the robot (Fig. 2 of the paper), and the plane in each."""

    # Number of rectangles, from right to left.
    rectangles: int = quantity(9, unit="rectangles", low=1, high=361)
    # [m] Width W, across, and depth L, along the direction of the rectangle.
    width: float = quantity(0.5, unit="m", above=0)
    depth: float = quantity(1.0, unit="m", above=0)
    # [m] From the origin to where the rectangles begin; half the robot's length leaves out what is below it.
    start: float = quantity(0.3, unit="m", low=0)
    # [deg] From the first direction to the last; the middle one is straight ahead.
    spread_deg: float = quantity(160.0, unit="deg", low=0, high=360)
    # How the plane is fitted: Eq. 1 of the paper over all points, or robustly over the cells of the surface.
    fit: str = quantity("robust", choices=FITS)
    surface: SurfaceConfig = field(default_factory=SurfaceConfig)

    def directions(self) -> np.ndarray:
        """Directions θ_k of the rectangles in H, left is positive, (K,) [rad]."""
        half = np.deg2rad(self.spread_deg) / 2
        return np.linspace(-half, half, self.rectangles) if self.rectangles > 1 else np.zeros(1)

    @property
    def reach(self) -> float:
        """Distance from the origin to the farthest corner of a rectangle [m]."""
        return float(np.hypot(self.start + self.depth, self.width / 2))
