"""Where a robot that must know its place goes, and where it needs landmarks: floor plans, topology, co-evolution."""

from .candidate_sites import SiteConfig, find_sites, initial_route
from .co_evolution import CoEvolution, CoEvolutionConfig
from .evolution_config import EvolutionConfig
from .evolve import Placement, evolve, placement_of
from .exact_order import shortest_order
from .exact_sites import FewestSites, fewest_sites
from .floor_plan import FloorPlan, plan_from_image, plan_from_walls
from .growing_cells import GrowingCells
from .information import InformationConfig, scans_along
from .landmark_extractor import LandmarkExtractor
from .landmarks import LandmarkConfig, LandmarkMap, find_landmarks
from .plan_files import PlanFile, read_floor_plan
from .problem import PlacementProblem, ProblemConfig, make_problem, problem_with
from .rounds import Round, Rounds, RoundsConfig, Verification, Verify, learn_from, run_rounds
from .topology import Topology, TopologyConfig, grow_topology

__all__ = [
    "CoEvolution",
    "CoEvolutionConfig",
    "EvolutionConfig",
    "FewestSites",
    "FloorPlan",
    "GrowingCells",
    "InformationConfig",
    "LandmarkConfig",
    "LandmarkExtractor",
    "LandmarkMap",
    "Placement",
    "PlacementProblem",
    "PlanFile",
    "ProblemConfig",
    "Round",
    "Rounds",
    "RoundsConfig",
    "SiteConfig",
    "Topology",
    "TopologyConfig",
    "Verification",
    "Verify",
    "evolve",
    "fewest_sites",
    "find_landmarks",
    "find_sites",
    "grow_topology",
    "initial_route",
    "learn_from",
    "make_problem",
    "placement_of",
    "plan_from_image",
    "plan_from_walls",
    "problem_with",
    "read_floor_plan",
    "run_rounds",
    "scans_along",
    "shortest_order",
]
