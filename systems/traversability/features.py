"""Features of the ground in rectangles ahead of a robot (row S3-a)."""

from dataclasses import dataclass

import numpy as np

from .feature_kernels import cell_planes, point_planes, slopes
from .surface_cells import find_steps, find_surface
from .terrain_config import TerrainConfig

# Ground beside a robot is not higher or lower than this, times the distance, and the clearance: 45°.
_STEEPEST = 1.0


@dataclass(frozen=True, eq=False)
class TerrainFeatureTable:
    """What the ground in K rectangles is like, from right to left. Read-only.

    All are NaN where too little was seen to fit a plane, but for `coverage` and `count`.

    Attributes:
        directions: θ_k in H, left is positive [rad].
        count: number of points (paper's fit) or of cells (robust fit) that were seen.
        mean_height: over the ground below the robot [m].
        pitch_slope, roll_slope: of the plane, along and across the direction, not negative, Eq. 2 and 3 [rad].
        roughness: variance of the distances to the plane, Eq. 4 [m²].
        coverage: share of the rectangle that was seen, in [0, 1].
        step_height: largest step, up or down [m].
        planes: a, b, c of z = a x + b y + c, (K, 3).
        far_edges: midpoints of the far edges in H, where the paper puts its sub-goals, (K, 2) [m].
    """

    directions: np.ndarray
    count: np.ndarray
    mean_height: np.ndarray
    pitch_slope: np.ndarray
    roll_slope: np.ndarray
    roughness: np.ndarray
    coverage: np.ndarray
    step_height: np.ndarray
    planes: np.ndarray
    far_edges: np.ndarray

    def __deepcopy__(self, memo: dict) -> "TerrainFeatureTable":
        return self

    @property
    def inputs(self) -> np.ndarray:
        """Pitch slope, roll slope and roughness, (K, 3), for the inference."""
        return np.column_stack([self.pitch_slope, self.roll_slope, self.roughness])


def describe_terrain(p_H: np.ndarray, config: TerrainConfig | None = None) -> TerrainFeatureTable:
    """Describes the ground that points show in the rectangles of `config`.

    Args:
        p_H: (N, 3) [m], in the heading frame: origin on the ground below the robot, z up, x ahead.

    With `fit: least_squares` the plane, mean height and roughness are the paper's, Eq. 1 to 6, over all points. With
    `robust` they are taken over the cells of the surface, see `find_surface`, each of which counts once however many
    points it has; the plane is that of most cells, see `robust_plane`, and what is not on it makes it rough. Coverage
    and steps are those of the surface either way.
    """
    config = config or TerrainConfig()
    surface, directions = config.surface, config.directions()
    p_H = np.ascontiguousarray(p_H, np.float32).reshape(-1, 3)
    half = int(np.ceil(config.reach / surface.cell)) + 1
    ceiling = surface.clearance + _STEEPEST * config.reach
    # The grid is centred on the origin, so that the surface to the left is found as that to the right.
    origin = np.full(2, -half * surface.cell)
    cells = find_surface(p_H, origin, (2 * half, 2 * half), surface.cell, clearance=surface.clearance, ceiling=ceiling)
    steps = find_steps(cells, surface)
    count, mean, planes, roughness, coverage, step = cell_planes(
        cells.low,
        cells.high,
        steps,
        float(cells.origin[0]),
        float(cells.origin[1]),
        cells.cell,
        directions,
        config.start,
        config.depth,
        config.width,
    )
    if config.fit == "least_squares":
        count, mean, planes, roughness = point_planes(
            p_H, directions, config.start, config.depth, config.width, ceiling
        )
    pitch_roll = np.array([slopes(a, b, theta) for (a, b, _), theta in zip(planes, directions, strict=True)])
    ahead = np.column_stack([np.cos(directions), np.sin(directions)])
    return TerrainFeatureTable(
        directions=directions,
        count=count.astype(int),
        mean_height=mean,
        pitch_slope=pitch_roll[:, 0],
        roll_slope=pitch_roll[:, 1],
        roughness=roughness,
        coverage=coverage,
        step_height=step,
        planes=planes,
        far_edges=(config.start + config.depth) * ahead,
    )
