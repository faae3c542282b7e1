"""Running examples of the systems that localise a robot with a 2D laser."""

from collections.abc import Callable

import numpy as np
from naraha.systems.localization import LaserRing
from naraha.systems.sensing import Scan, utm30lx
from naraha.systems.sensing.lidar import Returns, make_cloud
from pydrake.systems.framework import LeafSystem, System

from ..routes.route_examples import with_inputs


def laser_ring(seed: int) -> tuple[System, LeafSystem]:
    pattern = utm30lx()
    distances = np.random.default_rng(seed).uniform(1, 9, pattern.columns).astype(np.float32)
    returns = Returns(np.arange(pattern.columns), distances, np.zeros(pattern.columns, np.float32))
    return with_inputs(LaserRing(pattern), scan_S=Scan(make_cloud(pattern, returns), 0.0, pattern.period, 0))


LOCALIZATION_EXAMPLES: dict[str, Callable[[int], tuple[System, LeafSystem]]] = {"LaserRing": laser_ring}
