"""The end of a drive in Meshcat: the way that was driven, the goal, and where the last histograms looked."""

import numpy as np
from pydrake.geometry import Cylinder, Meshcat, Rgba
from pydrake.math import RigidTransform

from .recording import ODOMETRY, TRUTH, draw_trajectory
from .traverse_log import TraverseLog

_GOAL = Rgba(0.1, 0.6, 0.1, 0.6)


def draw_traverse(meshcat: Meshcat, log: TraverseLog) -> None:
    """Draws the goal and both paths."""
    scenario = log.scenario
    meshcat.SetObject("goal", Cylinder(scenario.reached, 0.02), _GOAL)
    meshcat.SetTransform("goal", RigidTransform(np.array([*scenario.goal[:2], 0.01])))
    draw_trajectory(meshcat, "truth", log.trajectories["truth"], TRUTH)
    draw_trajectory(meshcat, "odometry", log.trajectories["odometry"], ODOMETRY)
