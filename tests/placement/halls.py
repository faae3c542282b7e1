"""Small floor plans with known answers."""

from functools import cache

import numpy as np
from naraha.systems.placement import (
    FloorPlan,
    InformationConfig,
    PlacementProblem,
    ProblemConfig,
    SiteConfig,
    TopologyConfig,
    make_problem,
    plan_from_walls,
)

POINTS = np.array([[10.0, 4], [18, 4], [26, 4], [10, 12], [18, 12], [26, 12]])


def lines(*corners: tuple[float, float]) -> np.ndarray:
    """(m, 2, 2) walls along a polyline."""
    points = np.array(corners, float)
    return np.stack([points[:-1], points[1:]], axis=1)


def hall(more: np.ndarray | None = None, points: np.ndarray = POINTS, resolution: float = 0.1) -> FloorPlan:
    """A bare hall of 36 × 16 m, and more walls in it."""
    outer = lines((0.1, 0.1), (35.9, 0.1), (35.9, 15.9), (0.1, 15.9), (0.1, 0.1))
    walls = outer if more is None else np.concatenate([outer, more])
    return plan_from_walls(walls, np.array([36.0, 16.0]), np.array([2.0, 2.0, 0.0]), points, resolution=resolution)


@cache
def small_problem(limit: float = 0.18, seed: int = 0) -> PlacementProblem:
    """The bare hall with a laser of 6 m, so that its middle is without a landmark."""
    config = ProblemConfig(
        topology=TopologyConfig(seed=seed),
        sites=SiteConfig(spacing=3.0, near=4.0, most=12),
        information=InformationConfig(used_range=6.0),
        error_limit=limit,
        sight_range=6.0,
    )
    return make_problem(hall(), config)
