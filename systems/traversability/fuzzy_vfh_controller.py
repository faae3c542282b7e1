"""Choice of direction and sub-goal on the polar histogram of risk, as a system."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, EventStatus, LeafSystem, State

from ..config import check_config
from ..errors import PortError
from ..ports import eval_typed, weak_method
from ..tracking import planar_pose
from .ability import Ability, check_ability
from .histogram import RiskHistogram
from .risk_map import IMPASSABLE
from .risk_memory import RiskGrid
from .vfh_decide import decide
from .vfh_state import LOOKING, Command, Sight, VfhConfig, VfhState
from .wavefront import CostField, find_way, spread_costs


@dataclass(frozen=True, eq=False)
class _Held:
    """State and command of the last decision, and the cost to the goal with what it was computed from."""

    state: VfhState = VfhState(status=LOOKING)
    command: Command = Command()
    field: CostField | None = None
    key: object = None

    def __deepcopy__(self, memo: dict) -> "_Held":
        return self


class FuzzyVfhController(LeafSystem):
    """
    .. pydrake_system::

        name: FuzzyVfhController
        input_ports:
        - histogram
        - X_MB
        - goal
        - risk_memory
        - twist_command
        output_ports:
        - reference_pose
        - reference_twist
        - risk
        - status

    Leads a robot to a goal over ground that it can drive on (row S3-c): every `period` it chooses a direction of the
    histogram and sets a sub-goal there. Made to feed `KanayamaTracking`, with `risk` for Eq. 9.

    With `preset: paper` the sub-goal is the midpoint of the far edge of the candidate nearest to the goal, with its
    direction as heading and a fixed v_r, and no more; without candidates the robot waits with "no way". With
    `preset: full` it keeps to the cheapest way over remembered ground, which leads out of dead ends; the histogram,
    which is newer and finer, decides on the next metre. It turns and backs up where it must, notices when it is stuck,
    and says "no way" when it has looked around and there is none. v_r falls with the risk as K_x does, so that risk
    changes the speed and not the path.

    - `histogram` (`RiskHistogram`): of the ground ahead.
    - `X_MB` (RigidTransform): pose of the base in the map. On a slope that a turn would slide it down, a robot with
      `turn_slide` backs off first.
    - `goal` (2): x, y in M [m].
    - `risk_memory` (`RiskGrid`), optional: may be left unconnected. Then it heads for the goal, cannot leave dead ends,
      and "no way" means only that no candidate came up in a full turn.
    - `twist_command` (2), optional: v, omega that the drive is told [m/s, rad/s]. With it the robot notices when an
      edge too low for its LiDAR holds one side back and turns it, marks that, and backs up.
    - `reference_pose` (3): the sub-goal x, y, heading in M [m, m, rad]; the robot's own pose when it does not drive.
    - `reference_twist` (2): v_r [m/s], omega_r [rad/s].
    - `risk` (1): r of the rectangle or ground that was chosen, raised near what is impassable, see `nearness`; 0 when
      it does not drive.
    - `status` (str): "driving", "turning", "backing", "looking", "arrived" or "no way". The last two stand still;
      "no way" is left again when the memory finds a way.

    Raises:
        ConfigError: a value of the configuration or of the ability cannot be used.
        PortError: an input is not connected or of another type, or the goal or the pose is not finite.
    """

    def __init__(self, ability: Ability, config: VfhConfig | None = None):
        super().__init__()
        self._ability, self._config = ability, config or VfhConfig()
        check_ability(ability)
        check_config(self._config, where="vfh")
        self.DeclareAbstractInputPort("histogram", AbstractValue.Make(object()))
        self.DeclareAbstractInputPort("X_MB", AbstractValue.Make(RigidTransform()))
        self.DeclareVectorInputPort("goal", 2)
        self.DeclareAbstractInputPort("risk_memory", AbstractValue.Make(object()))
        self.DeclareVectorInputPort("twist_command", 2)
        state = self.abstract_state_ticket(self.DeclareAbstractState(AbstractValue.Make(_Held())))
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._config.period, 0.0, self._Decide)
        pose = self.input_port_ticket(self.GetInputPort("X_MB").get_index())
        self.DeclareVectorOutputPort("reference_pose", 3, self._CalcReferencePose, {state, pose})
        self.DeclareVectorOutputPort("reference_twist", 2, self._CalcReferenceTwist, {state})
        self.DeclareVectorOutputPort("risk", 1, self._CalcRisk, {state})
        self.DeclareAbstractOutputPort("status", lambda: Value[str](), weak_method(self._CalcStatus), {state})

    @staticmethod
    def _held(context: Context) -> _Held:
        held: Any = context.get_abstract_state(0)
        return held.get_value()

    def _Decide(self, context: Context, state: State) -> EventStatus:
        held, config = self._held(context), self._config
        histogram = eval_typed(self, context, "histogram", RiskHistogram)
        X_MB = eval_typed(self, context, "X_MB", RigidTransform)
        pose = planar_pose(X_MB)
        goal = eval_typed(self, context, "goal", np.ndarray)
        for name, value in (("goal", goal), ("X_MB", pose)):
            if not np.isfinite(value).all():
                where = f"FuzzyVfhController.{name}"
                raise PortError("not finite", where=where, value=value.tolist(), valid="finite numbers")
        grid = None
        if config.preset != "paper" and self.GetInputPort("risk_memory").HasValue(context):
            grid = eval_typed(self, context, "risk_memory", RiskGrid)
        field, key = held.field, held.key
        way: np.ndarray | None = goal
        obstacles = np.zeros((0, 2))
        index = held.state.index + 1
        if grid is not None:
            index, wanted = grid.index, (grid.index, (float(goal[0]), float(goal[1])), held.state.marks)
            if key != wanted:
                field, key = self._spread(grid, goal, pose, held), wanted
            if field is not None:
                way = find_way(field, pose[:2])
            reach = 0.5 * math.hypot(*self._ability.footprint) + max(config.longest_back, config.beside)
            obstacles = obstacles_near(grid, pose, reach)
        yaw_rate = np.nan
        if self.GetInputPort("twist_command").HasValue(context):
            yaw_rate = float(eval_typed(self, context, "twist_command", np.ndarray)[1])
        now, downhill = context.get_time(), downhill_of(X_MB)
        sight = Sight(now, pose, goal.copy(), histogram, field, index, way, obstacles, yaw_rate, downhill)
        after, command = decide(held.state, sight, self._ability, config)
        state.get_mutable_abstract_state(0).set_value(_Held(after, command, field, key))
        return EventStatus.Succeeded()

    def _spread(self, grid: RiskGrid, goal: np.ndarray, pose: np.ndarray, held: _Held) -> CostField | None:
        if not grid.risk.size:
            return None
        return spread_costs(
            grid.risk,
            grid.origin,
            grid.cell,
            goal,
            pose[:2],
            self._ability,
            self._config.wavefront,
            marks=np.reshape(held.state.marks, (-1, 4)),
            tolerance=self._config.tolerance,
            before=held.field,
        )

    def _CalcReferencePose(self, context: Context, output: BasicVector) -> None:
        subgoal = self._held(context).command.subgoal
        own = planar_pose(eval_typed(self, context, "X_MB", RigidTransform))
        output.SetFromVector(own if subgoal is None else np.array(subgoal))

    def _CalcReferenceTwist(self, context: Context, output: BasicVector) -> None:
        command = self._held(context).command
        output.SetFromVector(np.array([command.v_r, command.omega_r]))

    def _CalcRisk(self, context: Context, output: BasicVector) -> None:
        output[0] = self._held(context).command.risk

    def _CalcStatus(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._held(context).state.status)


def downhill_of(X_MB: RigidTransform) -> tuple[float, float]:
    """Where it goes down below the robot, in its heading frame, as long as the sine of its tilt [-]."""
    forward, _, up = X_MB.rotation().matrix().T
    c, s = forward[:2] / max(float(np.hypot(*forward[:2])), 1e-9)
    return float(c * up[0] + s * up[1]), float(c * up[1] - s * up[0])


def obstacles_near(grid: RiskGrid, pose: np.ndarray, reach: float) -> np.ndarray:
    """Centres of impassable cells within `reach` [m] of the robot, (n, 2) in its heading frame [m]."""
    low = np.maximum(np.floor((pose[:2] - reach - grid.origin) / grid.cell).astype(int), 0)
    high = np.maximum(np.ceil((pose[:2] + reach - grid.origin) / grid.cell).astype(int), 0)
    cells = np.argwhere(grid.risk[low[0] : high[0], low[1] : high[1]] >= IMPASSABLE) + low
    away = grid.origin + (cells + 0.5) * grid.cell - pose[:2]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    away = away @ np.array([[c, -s], [s, c]])
    return away[np.hypot(*away.T) <= reach]
