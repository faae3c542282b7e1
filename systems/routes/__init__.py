"""Routes on the semantic map: learnt, proven against value iteration, and reused on the next map."""

from .collision_boxes import add_boxes, merge_voxels
from .distinct_routes import DistinctRoutes
from .find_routes import blocked_at, find_routes, is_open
from .frontiers import FrontierConfig, View, ViewGoal, find_goals, hiding_cells, seen_cells
from .grid_route import GridRouteEnv, GridRouteVectorEnv, register_environments
from .make_grid import make_route_grid
from .motion_model import ACTIONS, HEADINGS, MotionModel, deterministic, from_outcomes, from_primitives, slipping
from .path_smoothing import smooth_path
from .policy import RollOut, RoutePolicy, roll_out
from .policy_files import PolicyFileError, read_policy, write_policy
from .policy_lookup import PolicyLookup, looked_up
from .policy_reuse import reuse_values
from .primitives import Ground, Outcome, Primitives, motion_model, outcome_of, read_primitives, write_primitives
from .q_learning import Learned, Learning, LearningConfig, advance, begin, learn, learn_many, paper_learning
from .route import Route
from .route_config import RoutesConfig, SmoothingConfig
from .route_files import RouteFileError, read_routes, write_routes
from .route_grid import DOSE, FENCE, FREE, HOT, KINDS, OCCUPIED, TERRAINS, UNKNOWN, WATER, RouteGrid, clearance_of
from .route_learner import LearningProgress, RouteLearner, RouteLearnerConfig
from .route_task import RewardConfig, RouteTask, paper_rewards
from .survey_loop import SurveyLoop
from .survey_state import LoopState, SurveyLoopConfig
from .value_iteration import Solution, expected_motions, expected_sum, optimality_gap, solve
from .voxel_world import VoxelWorld
from .voxels import Voxels, make_voxels
from .world_config import VoxelWorldConfig

register_environments()

__all__ = [
    "ACTIONS",
    "DOSE",
    "FENCE",
    "FREE",
    "HEADINGS",
    "HOT",
    "KINDS",
    "OCCUPIED",
    "TERRAINS",
    "UNKNOWN",
    "WATER",
    "DistinctRoutes",
    "FrontierConfig",
    "GridRouteEnv",
    "GridRouteVectorEnv",
    "Ground",
    "Learned",
    "Learning",
    "LearningConfig",
    "LearningProgress",
    "LoopState",
    "MotionModel",
    "Outcome",
    "PolicyFileError",
    "PolicyLookup",
    "Primitives",
    "RewardConfig",
    "RollOut",
    "Route",
    "RouteFileError",
    "RouteGrid",
    "RouteLearner",
    "RouteLearnerConfig",
    "RoutePolicy",
    "RouteTask",
    "RoutesConfig",
    "SmoothingConfig",
    "Solution",
    "SurveyLoop",
    "SurveyLoopConfig",
    "View",
    "ViewGoal",
    "VoxelWorld",
    "VoxelWorldConfig",
    "Voxels",
    "add_boxes",
    "advance",
    "begin",
    "blocked_at",
    "clearance_of",
    "deterministic",
    "expected_motions",
    "expected_sum",
    "find_goals",
    "find_routes",
    "from_outcomes",
    "from_primitives",
    "hiding_cells",
    "is_open",
    "learn",
    "learn_many",
    "looked_up",
    "make_route_grid",
    "make_voxels",
    "merge_voxels",
    "motion_model",
    "optimality_gap",
    "outcome_of",
    "paper_learning",
    "paper_rewards",
    "read_policy",
    "read_primitives",
    "read_routes",
    "register_environments",
    "reuse_values",
    "roll_out",
    "seen_cells",
    "slipping",
    "smooth_path",
    "solve",
    "write_policy",
    "write_primitives",
    "write_routes",
]
