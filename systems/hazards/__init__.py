"""What the map says of hazards: water, heat, and the semantic map that puts them together (S0-c, S0-f)."""

from .classes import CLASSES, SemanticClass
from .heat import HeatConfig, HeatDetector, heat_probability, hot_regions
from .regions import HotSpot, Region, RegionConfig, find_regions
from .semantic_map import SemanticMap, SemanticMapConfig
from .shot_grid import ShotConfig, ShotGrid
from .water import FILTERS, WaterConfig, find_puddles, water_probability
from .water_detector import WaterDetector

__all__ = [
    "CLASSES",
    "FILTERS",
    "HeatConfig",
    "HeatDetector",
    "HotSpot",
    "Region",
    "RegionConfig",
    "SemanticClass",
    "SemanticMap",
    "SemanticMapConfig",
    "ShotConfig",
    "ShotGrid",
    "WaterConfig",
    "WaterDetector",
    "find_puddles",
    "find_regions",
    "heat_probability",
    "hot_regions",
    "water_probability",
]
