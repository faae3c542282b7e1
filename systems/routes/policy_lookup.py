"""LeafSystem that looks up what a policy says about the robot's pose, as the paper drives (row S0-i)."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from ..ports import eval_typed
from ..tracking import planar_pose
from .policy import RoutePolicy


def looked_up(policy: RoutePolicy, pose: np.ndarray) -> int:
    """Index into `ACTIONS` of the best motion at a pose (3,) x, y, heading in M [m, m, rad].

    -1 at the goal (in its cell or within `goal_radius`), outside the map, and in a cell that is not free.
    """
    pose = np.asarray(pose, float)
    action = policy.action_of(pose)
    if action is None:
        return -1
    goal = np.array(policy.goal)
    cell, goal_cell = (np.floor((xy - policy.origin) / policy.cell) for xy in (pose[:2], goal))
    there = (cell == goal_cell).all() or np.hypot(*(pose[:2] - goal)) <= policy.goal_radius
    return -1 if there else action


class PolicyLookup(LeafSystem):
    """
    .. pydrake_system::

        name: PolicyLookup
        input_ports:
        - policy
        - X_MB
        output_ports:
        - action

    Executes a policy as a table: `action` (1) is the index into `ACTIONS` of the best motion where the robot is, -1
    where there is none (`looked_up`). Made to feed `MotionPrimitives`.

    - `policy` (`RoutePolicy`), as from `RouteLearner` or `read_policy`.
    - `X_MB` (RigidTransform): base B in the map M of the policy.

    Raises:
        PortError: an input is not connected or of another type.
    """

    def __init__(self) -> None:
        super().__init__()
        self.DeclareAbstractInputPort("policy", AbstractValue.Make(object()))
        self.DeclareAbstractInputPort("X_MB", AbstractValue.Make(RigidTransform()))
        self.DeclareVectorOutputPort("action", 1, self._CalcAction)

    def _CalcAction(self, context: Context, output: BasicVector) -> None:
        pose = planar_pose(eval_typed(self, context, "X_MB", RigidTransform))
        output[0] = looked_up(eval_typed(self, context, "policy", RoutePolicy), pose)
