"""2D localisation and mapping with a laser scanner."""

from .carmen_log import CarmenLog, CarmenLogError, read_carmen_log
from .correlative_search import CorrelativeSearchConfig, correlative_search, make_search_image
from .evolution_localizer import EvolutionLocalizer
from .evolution_strategy import EvolutionConfig, evolve, evolve_as_paper
from .graph_mapping import GraphMapper, GraphMappingConfig
from .laser_scan import LaserRing, LaserScan, LaserScanError, no_scan, ring_to_laser_scan
from .likelihood_field import LikelihoodField, make_field
from .localizer_config import LocalizerConfig
from .occupancy_grid import OccupancyConfig, OccupancyGrid, OccupancyGridError
from .scan_localization import Localization, localize, start_localization
from .uncertainty import PlanarOdometryAccuracy, odometry_step_covariance

__all__ = [
    "CarmenLog",
    "CarmenLogError",
    "CorrelativeSearchConfig",
    "EvolutionConfig",
    "EvolutionLocalizer",
    "GraphMapper",
    "GraphMappingConfig",
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
    "correlative_search",
    "evolve",
    "evolve_as_paper",
    "localize",
    "make_field",
    "make_search_image",
    "no_scan",
    "odometry_step_covariance",
    "read_carmen_log",
    "ring_to_laser_scan",
    "start_localization",
]
