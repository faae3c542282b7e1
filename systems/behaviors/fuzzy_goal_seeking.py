"""The behaviour that drives to a goal, by fuzzy rules (row S4-g)."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from ..ports import eval_typed
from ..tracking import planar_pose
from .fuzzy_rules import FuzzyRules, RuleBase

GOAL_INPUTS = ("distance", "bearing")
"""[m], and [rad] from the robot's x axis, left positive."""


def goal_error(pose: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Distance [m] and bearing [rad] in (−π, π] of a goal (2,) seen from a pose (3,) x, y, heading [m, m, rad]."""
    dx, dy = goal[:2] - pose[:2]
    bearing = np.arctan2(dy, dx) - pose[2] if dx or dy else 0.0
    return np.array([np.hypot(dx, dy), np.arctan2(np.sin(bearing), np.cos(bearing))])


class FuzzyGoalSeeking(LeafSystem):
    """
    .. pydrake_system::

        name: FuzzyGoalSeeking
        input_ports:
        - X_MB
        - goal
        output_ports:
        - twist
        - goal_error

    The behaviour of S4-g that drives to a goal and knows nothing of obstacles: rules on distance and bearing of the
    goal give speed and yaw rate, see `RuleBase`.

    - `X_MB` (RigidTransform): pose of the base B in the map M; its projection on the floor counts.
    - `goal` (2): x, y in M [m].
    - `twist` (2): v [m/s] and ω [rad/s] that this behaviour wants.
    - `goal_error` (2): distance [m] and bearing [rad], left positive.

    Raises `ConfigError` when the rules are not such rules, `PortError` when `X_MB` is missing or of another type.
    """

    def __init__(self, rules: FuzzyRules, *, where: object = "goal_seeking"):
        super().__init__()
        self._rules = RuleBase(rules, GOAL_INPUTS, 2, where=where)
        self.DeclareAbstractInputPort("X_MB", AbstractValue.Make(RigidTransform()))
        self.DeclareVectorInputPort("goal", 2)
        self.DeclareVectorOutputPort("twist", 2, self._CalcTwist)
        self.DeclareVectorOutputPort("goal_error", 2, self._CalcGoalError)

    def _goal_error(self, context: Context) -> np.ndarray:
        pose = planar_pose(eval_typed(self, context, "X_MB", RigidTransform))
        return goal_error(pose, eval_typed(self, context, "goal", np.ndarray))

    def _CalcTwist(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._rules.infer(self._goal_error(context)))

    def _CalcGoalError(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._goal_error(context))
