"""The articulated snake: kinematics, recovery by its null space, shift control, and how it notices that it is stuck."""

from .actuator_faults import ActuatorFaults, ActuatorFaultsConfig, ActuatorReport, Fault
from .body_path import BodyPath, BodyShape, edge_radius, fit_shape, path_of_body, path_over_ground
from .chain import ChainKinematics
from .contact_pads import PAD_PLACES, ContactPads, ContactPadsConfig, find_pads
from .inertial_speed import InertialSpeed, InertialSpeedConfig
from .null_space_config import PRESETS, NullSpaceConfig, preset
from .null_space_recovery import NullSpaceRecovery
from .posture import axle_positions, half_poses
from .range_sensors import RANGE_SIDES, HalfShape, RangeSensors, RangeSensorsConfig
from .recovery_motion import RecoveryCommand, RecoveryMotion, joint_name, middle_in_head, plan_motion
from .recovery_planner import (
    Proposal,
    Proposals,
    RankedProposal,
    RecoveryPlanner,
    RecoveryPlannerConfig,
    Rehearsal,
    propose,
    rank,
)
from .recovery_run import start_run, step_run
from .recovery_state import RecoveryRun, RecoveryStatus, idle_run
from .shift_control import NO_PATH, ShiftControl, ShiftControlConfig
from .snake_body import SnakeBody
from .snake_pilot import MOVES, Move, SnakePilot, SnakePilotConfig
from .stuck_detector import StuckDetector, StuckDetectorConfig
from .stuck_features import SnakeMeasures, StuckFeatures
from .stuck_rules import Diagnosis, StuckRules, class_scores, diagnose, stuck_probability
from .tip_over_margin import Support, TipOverMargin, TipOverMarginConfig, convex_hull, tip_over_margin

__all__ = [
    "MOVES",
    "NO_PATH",
    "PAD_PLACES",
    "PRESETS",
    "RANGE_SIDES",
    "ActuatorFaults",
    "ActuatorFaultsConfig",
    "ActuatorReport",
    "BodyPath",
    "BodyShape",
    "ChainKinematics",
    "ContactPads",
    "ContactPadsConfig",
    "Diagnosis",
    "Fault",
    "HalfShape",
    "InertialSpeed",
    "InertialSpeedConfig",
    "Move",
    "NullSpaceConfig",
    "NullSpaceRecovery",
    "Proposal",
    "Proposals",
    "RangeSensors",
    "RangeSensorsConfig",
    "RankedProposal",
    "RecoveryCommand",
    "RecoveryMotion",
    "RecoveryPlanner",
    "RecoveryPlannerConfig",
    "RecoveryRun",
    "RecoveryStatus",
    "Rehearsal",
    "ShiftControl",
    "ShiftControlConfig",
    "SnakeBody",
    "SnakeMeasures",
    "SnakePilot",
    "SnakePilotConfig",
    "StuckDetector",
    "StuckDetectorConfig",
    "StuckFeatures",
    "StuckRules",
    "Support",
    "TipOverMargin",
    "TipOverMarginConfig",
    "axle_positions",
    "class_scores",
    "convex_hull",
    "diagnose",
    "edge_radius",
    "find_pads",
    "fit_shape",
    "half_poses",
    "idle_run",
    "joint_name",
    "middle_in_head",
    "path_of_body",
    "path_over_ground",
    "plan_motion",
    "preset",
    "propose",
    "rank",
    "start_run",
    "step_run",
    "stuck_probability",
    "tip_over_margin",
]
