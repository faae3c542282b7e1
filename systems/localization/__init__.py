"""2D localisation and mapping with a laser scanner."""

from .evolution_localizer import EvolutionLocalizer
from .evolution_strategy import EvolutionConfig, evolve, evolve_as_paper
from .laser_scan import LaserRing, LaserScan, LaserScanError, no_scan, ring_to_laser_scan
from .likelihood_field import LikelihoodField, make_field
from .occupancy_grid import OccupancyConfig, OccupancyGrid, OccupancyGridError
from .scan_localization import Localization, LocalizerConfig, localize, start_localization
from .uncertainty import PlanarOdometryAccuracy, odometry_step_covariance

__all__ = [
    "EvolutionConfig",
    "EvolutionLocalizer",
    "LaserRing",
    "LaserScan",
    "LaserScanError",
    "LikelihoodField",
    "Localization",
    "LocalizerConfig",
    "OccupancyConfig",
    "OccupancyGrid",
    "OccupancyGridError",
    "PlanarOdometryAccuracy",
    "evolve",
    "evolve_as_paper",
    "localize",
    "make_field",
    "no_scan",
    "odometry_step_covariance",
    "ring_to_laser_scan",
    "start_localization",
]
