"""Can the robot drive there: features of the ground, fuzzy inference, risk maps."""

from .ability import Ability, check_ability, read_ability, write_ability
from .features import TerrainFeatureTable, describe_terrain
from .fuzzy_traversability import FuzzyTraversability
from .fuzzy_vfh_controller import FuzzyVfhController
from .histogram import REASONS, RiskHistogram, make_histogram
from .mamdani import FuzzyConfig, GradeTerms, Inference, Mamdani, SizeTerms, default_rules
from .polar_risk_histogram import PolarRiskHistogram
from .risk_map import IMPASSABLE, RiskMap, RiskMapConfig, make_risk_map, too_high
from .risk_memory import RiskGrid, RiskMemory, RiskMemoryConfig
from .surface_cells import SurfaceCells, find_surface
from .terrain_config import SurfaceConfig, TerrainConfig
from .terrain_features import TerrainFeatures
from .vfh_state import VfhConfig

__all__ = [
    "IMPASSABLE",
    "REASONS",
    "Ability",
    "FuzzyConfig",
    "FuzzyTraversability",
    "FuzzyVfhController",
    "GradeTerms",
    "Inference",
    "Mamdani",
    "PolarRiskHistogram",
    "RiskGrid",
    "RiskHistogram",
    "RiskMap",
    "RiskMapConfig",
    "RiskMemory",
    "RiskMemoryConfig",
    "SizeTerms",
    "SurfaceCells",
    "SurfaceConfig",
    "TerrainConfig",
    "TerrainFeatureTable",
    "TerrainFeatures",
    "VfhConfig",
    "check_ability",
    "default_rules",
    "describe_terrain",
    "find_surface",
    "make_histogram",
    "make_risk_map",
    "read_ability",
    "too_high",
    "write_ability",
]
