"""The behaviour that keeps clear of obstacles, by fuzzy rules on what a 2D laser sees (row S4-g)."""

from dataclasses import dataclass, field

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from ..config import check_config, quantity
from ..ports import eval_typed
from ..sensing import Scan
from .free_way import free_ways
from .fuzzy_rules import FuzzyRules, RuleBase

AVOIDANCE_INPUTS = ("right", "front_right", "front", "front_left", "left", "bearing")
"""Free ways [m] in five directions, and the bearing of the goal [rad]: on which side to pass if both are free."""


@dataclass(kw_only=True)
class AvoidanceConfig:
    """What counts as free, and the rules."""

    # [m] radius of the disc that must be free: the robot's and a margin.
    radius: float = quantity(0.33, unit="m", above=0)
    # [m] no way longer than this matters.
    reach: float = quantity(2.5, unit="m", above=0)
    # [deg] directions of `right`, `front_right`, `front`, `front_left` and `left`.
    directions_deg: list[float] = quantity([-80.0, -40.0, 0.0, 40.0, 80.0], unit="deg", low=-180, high=180)
    rules: FuzzyRules = field(default_factory=FuzzyRules)

    def directions(self) -> np.ndarray:
        """Of the free ways, (5,) [rad]."""
        return np.deg2rad(self.directions_deg)


def obstacle_points(scan: Scan, X_BS: RigidTransform) -> np.ndarray:
    """Points of a scan in the base frame seen from above, (N, 2) [m]."""
    R, p = X_BS.rotation().matrix(), X_BS.translation()
    points: np.ndarray = scan.p_SP.astype(float) @ R[:2].T + p[:2]
    return points


class FuzzyObstacleAvoidance(LeafSystem):
    """
    .. pydrake_system::

        name: FuzzyObstacleAvoidance
        input_ports:
        - scan_S
        - X_BS
        - goal_error
        output_ports:
        - twist
        - free_ways

    The behaviour of S4-g that turns away from obstacles: how far the robot could drive in each of five directions (see
    `free_ways`) goes through fuzzy rules (`RuleBase`). All that the laser sees is an obstacle.

    - `scan_S` (Scan): of a level 2D laser. Before the first scan nothing is free.
    - `X_BS` (RigidTransform): pose of the laser in the base B.
    - `goal_error` (2): distance [m] and bearing [rad] of the goal; the bearing says on which side to pass an obstacle
      when both are free.
    - `twist` (2): v [m/s] and ω [rad/s] that this behaviour wants.
    - `free_ways` (5): [m], from right to left, at most the `reach`.

    Raises `ConfigError` when the rules are not such rules, `PortError` for inputs that are missing or of another type.
    """

    def __init__(self, config: AvoidanceConfig, *, where: object = "obstacle_avoidance"):
        super().__init__()
        check_config(config, where=where)
        self._config = config
        self._rules = RuleBase(config.rules, AVOIDANCE_INPUTS, 2, where=where)
        self._directions = config.directions()
        self.DeclareAbstractInputPort("scan_S", AbstractValue.Make(object()))
        self.DeclareAbstractInputPort("X_BS", AbstractValue.Make(RigidTransform()))
        self.DeclareVectorInputPort("goal_error", 2)
        self.DeclareVectorOutputPort("twist", 2, self._CalcTwist)
        self.DeclareVectorOutputPort("free_ways", len(self._directions), self._CalcFreeWays)

    def _free_ways(self, context: Context) -> np.ndarray:
        scan = eval_typed(self, context, "scan_S", Scan)
        if scan.index < 0:
            return np.zeros(len(self._directions))
        points = obstacle_points(scan, eval_typed(self, context, "X_BS", RigidTransform))
        return free_ways(points, self._directions, self._config.radius, self._config.reach)

    def _CalcTwist(self, context: Context, output: BasicVector) -> None:
        bearing = eval_typed(self, context, "goal_error", np.ndarray)[1]
        ways = np.asarray(self.GetOutputPort("free_ways").Eval(context))
        output.SetFromVector(self._rules.infer(np.append(ways, bearing)))

    def _CalcFreeWays(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._free_ways(context))
