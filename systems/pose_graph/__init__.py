"""Pose graphs: optimisation, files, loops that are found and loops that are believed."""

from .g2o_files import read_g2o, write_g2o
from .graph import (
    ATTITUDE,
    KINDS,
    LOOP,
    ODOMETRY,
    REGISTRATION,
    PoseGraph,
    PoseGraphError,
    chi_squared,
    dead_reckoning,
    residuals,
)
from .keyframe_graph import KeyframeGraph, Loop, PoseGraphConfig, add_keyframe, finish
from .loop_detection import LoopCheck, LoopDetectionConfig, Place, PlaceRecognition, check_loop, find_candidates
from .optimize import Optimum, optimize
from .pose_graph_slam import GraphHealth, PoseGraphSlam
from .robust_loops import LoopDecision, RobustLoopsConfig, decide_loops

__all__ = [
    "ATTITUDE",
    "KINDS",
    "LOOP",
    "ODOMETRY",
    "REGISTRATION",
    "GraphHealth",
    "KeyframeGraph",
    "Loop",
    "LoopCheck",
    "LoopDecision",
    "LoopDetectionConfig",
    "Optimum",
    "Place",
    "PlaceRecognition",
    "PoseGraph",
    "PoseGraphConfig",
    "PoseGraphError",
    "PoseGraphSlam",
    "RobustLoopsConfig",
    "add_keyframe",
    "check_loop",
    "chi_squared",
    "dead_reckoning",
    "decide_loops",
    "find_candidates",
    "finish",
    "optimize",
    "read_g2o",
    "residuals",
    "write_g2o",
]
