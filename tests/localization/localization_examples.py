"""Running examples of the systems that localise a robot with a 2D laser."""

from collections.abc import Callable

import numpy as np
from naraha.systems.localization import EvolutionLocalizer, LaserRing, LocalizerConfig, OccupancyGrid
from naraha.systems.sensing import Scan, utm30lx
from naraha.systems.sensing.lidar import Returns, make_cloud
from pydrake.math import RigidTransform
from pydrake.systems.framework import LeafSystem, System

from ..routes.route_examples import with_inputs
from .rooms import rasterised, room, scan_in


def laser_ring(seed: int) -> tuple[System, LeafSystem]:
    pattern = utm30lx()
    distances = np.random.default_rng(seed).uniform(1, 9, pattern.columns).astype(np.float32)
    returns = Returns(np.arange(pattern.columns), distances, np.zeros(pattern.columns, np.float32))
    return with_inputs(LaserRing(pattern), scan_S=Scan(make_cloud(pattern, returns), 0.0, pattern.period, 0))


def evolution_localizer(seed: int) -> tuple[System, LeafSystem]:
    walls = room()
    occupied, origin = rasterised(walls)
    grid = OccupancyGrid.from_plan(occupied, 0.05, origin)
    system = EvolutionLocalizer(LocalizerConfig(mapping=True), grid=grid, start=np.array([2.0, 3.0, 0.2]), seed=seed)
    scan = scan_in(walls, np.array([2.05, 3.0, 0.2]), np.random.default_rng(seed))
    return with_inputs(system, laser_scan=scan, X_OB=RigidTransform([1, 0, 0]))


LOCALIZATION_EXAMPLES: dict[str, Callable[[int], tuple[System, LeafSystem]]] = {
    "EvolutionLocalizer": evolution_localizer,
    "LaserRing": laser_ring,
}
