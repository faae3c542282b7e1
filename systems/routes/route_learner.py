"""The system that learns a route on the present map while the world goes on."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from ..config import check_config, quantity
from ..errors import InputError
from ..ports import eval_typed, weak_method
from .motion_model import HEADINGS, MotionModel, deterministic
from .policy import RoutePolicy
from .policy_reuse import reuse_values
from .q_learning import Learning, LearningConfig, advance, begin
from .route_grid import RouteGrid
from .route_task import RewardConfig, RouteTask
from .value_iteration import Solution, optimality_gap, solve


@dataclass(kw_only=True)
class RouteLearnerConfig:
    """How much is learnt when, and when it is enough."""

    # [s] Interval of the updates, in simulated time.
    period: float = quantity(0.1, unit="s", above=0)
    # Motions that are learnt from at an update: fixed, so that the same seed gives the same policy on any machine.
    steps_per_update: int = quantity(200_000, low=1)
    # Learning rests when the route loses no more than this share more than the best one.
    gap: float = quantity(0.05, low=0)
    # Motions in all after which it rests anyway, until the map, start or goal changes.
    most_steps: int = quantity(50_000_000, low=1)
    # [m] Cells with their centre within it are the goal too.
    goal_radius: float = quantity(0.0, unit="m", low=0)
    # Policies of earlier maps and goals that are kept as a start for the next.
    reused_policies: int = quantity(4, low=0)
    seed: int = quantity(0, low=0)
    learning: LearningConfig = field(default_factory=LearningConfig)
    rewards: RewardConfig = field(default_factory=RewardConfig)


@dataclass(frozen=True, eq=False)
class LearningProgress:
    """Attributes:
    status: "waiting" (there is nothing to learn, `reason` says why), "learning", "certified", "budget" (all steps
        used without a certificate) or "arrived" (the start is at the goal).
    reason: in words, "" when there is none to give.
    episodes: that began at the start and ended. steps: motions learnt from.
    gap: what the learnt route loses more than the best one, inf while it may not arrive.
    curve_motions, curve_rewards: (E,) of the first episodes; motions are negative without the goal.
    """

    status: str = "waiting"
    reason: str = "no map yet"
    episodes: int = 0
    steps: int = 0
    gap: float = np.inf
    curve_motions: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    curve_rewards: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def certified(self) -> bool:
        return self.status == "certified"


@dataclass(frozen=True, eq=False)
class _Learner:
    """Abstract state; read-only, so that Drake may share it instead of copying it at every update."""

    task: RouteTask | None = None
    solution: Solution | None = None
    learning: Learning | None = None
    gap: float = np.inf
    status: str = "waiting"
    reason: str = "no map yet"
    policies: tuple[RoutePolicy, ...] = ()

    def __deepcopy__(self, memo: dict) -> "_Learner":
        return self


class RouteLearner(LeafSystem):
    """
    .. pydrake_system::

        name: RouteLearner
        input_ports:
        - route_grid
        - start
        - goal
        output_ports:
        - policy
        - learning

    Learns the way over `route_grid` (`RouteGrid`) from the pose `start` (3: x, y, heading in M [m, m, rad]) to
    `goal` (2: x, y in M [m]) by Q-learning (row S0-h, Eq. 8; see `LearningConfig`), a fixed number of motions at every
    update, and rests when value iteration certifies the route. When the map or the goal changes it begins anew from
    what it has learnt before (`reuse_values`); when only the start moves, it goes on with the same values.

    - `policy` (`RoutePolicy`): as learnt so far; an empty one, which knows no motion anywhere, before.
    - `learning` (`LearningProgress`): how far it is.

    A start or goal outside the grid, not free, not finite or without a way between them is no error: the map of a
    robot under way changes, and so `learning` says "waiting" and why.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PortError: an input is not connected or of another type.
    """

    def __init__(self, config: RouteLearnerConfig | None = None, *, motion: MotionModel | None = None):
        """
        Args:
            motion: what the motions of the robot lead to; without it each does what it says.
        """
        super().__init__()
        self._config = config or RouteLearnerConfig()
        check_config(self._config, key="route_learner")
        self._motion = motion or deterministic()
        self.DeclareAbstractInputPort("route_grid", AbstractValue.Make(object()))
        self.DeclareVectorInputPort("start", 3)
        self.DeclareVectorInputPort("goal", 2)
        state = self.abstract_state_ticket(self.DeclareAbstractState(AbstractValue.Make(_Learner())))
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._config.period, 0.0, self._Learn)
        nothing = RoutePolicy.nothing(self._config.rewards)
        self.DeclareAbstractOutputPort(
            "policy", lambda: AbstractValue.Make(nothing), weak_method(self._CalcPolicy), {state}
        )
        self.DeclareAbstractOutputPort(
            "learning", lambda: AbstractValue.Make(LearningProgress()), weak_method(self._CalcLearning), {state}
        )

    def _Learn(self, context: Context, state: State) -> EventStatus:
        grid = eval_typed(self, context, "route_grid", RouteGrid)
        start = eval_typed(self, context, "start", np.ndarray)
        goal = eval_typed(self, context, "goal", np.ndarray)
        before = self._learner(context)
        after = self._with_more_steps(self._with_inputs(before, grid, start, goal))
        if after is before:
            return EventStatus.DidNothing()
        state.get_mutable_abstract_state(0).set_value(after)
        return EventStatus.Succeeded()

    def _with_inputs(self, known: _Learner, grid: RouteGrid, start: np.ndarray, goal: np.ndarray) -> _Learner:
        """`known`, begun anew if the map or the goal is another, and moved if the start is."""
        try:
            task = known.task
            if task is None or task.grid.fingerprint != grid.fingerprint or task.goal != tuple(goal.tolist()):
                task = self._task(grid, goal)
                known = _Learner(task, policies=self._policies(known))
            return self._with_start(known, task, task.state_of(start))
        except InputError as error:
            if (known.status, known.reason) == ("waiting", str(error)):
                return known
            return replace(known, status="waiting", reason=str(error))

    def _task(self, grid: RouteGrid, goal: np.ndarray) -> RouteTask:
        x, y = goal.tolist()
        return RouteTask(grid, (x, y), self._config.rewards, self._motion, self._config.goal_radius)

    def _policies(self, known: _Learner) -> tuple[RoutePolicy, ...]:
        """The newest policies, that of `known` among them."""
        policies = known.policies
        if known.task is not None and known.learning is not None:
            policies = (*policies, RoutePolicy.of(known.task, known.learning.q))
        return policies[len(policies) - min(len(policies), self._config.reused_policies) :]

    def _with_start(self, known: _Learner, task: RouteTask, start: int) -> _Learner:
        learning = known.learning
        if learning is not None and learning.start == start and known.status in ("learning", "certified", "budget"):
            return known
        if task.goal_cells.flat[start // HEADINGS]:
            return replace(known, status="arrived", reason="") if known.status != "arrived" else known
        if not task.can_reach(start):
            raise InputError("no way leads from the start to the goal", where="route_grid")
        if learning is None:
            q = reuse_values(task, known.policies) if known.policies else None
            learning = begin(task, start, self._config.learning, seed=self._config.seed, q=q)
        learning = replace(learning, start=start, counters=np.array([start, 0, 1]), earned=np.zeros(1))
        return self._looked_at(known, task, learning)

    def _with_more_steps(self, known: _Learner) -> _Learner:
        if known.status != "learning" or known.task is None or known.learning is None:
            return known
        steps = min(self._config.steps_per_update, self._config.most_steps - known.learning.steps)
        learning = advance(known.task, known.learning, self._config.learning, steps)
        return self._looked_at(known, known.task, learning)

    def _looked_at(self, known: _Learner, task: RouteTask, learning: Learning) -> _Learner:
        """`known` with `learning`, and with how good that is."""
        solution = known.solution or solve(task)
        gap = optimality_gap(task, learning.q, learning.start, solution)
        status = "certified" if gap <= self._config.gap else "learning"
        if status == "learning" and learning.steps >= self._config.most_steps:
            status = "budget"
        return replace(known, solution=solution, learning=learning, gap=gap, status=status, reason="")

    @staticmethod
    def _learner(context: Context) -> _Learner:
        held: Any = context.get_abstract_state(0)
        return held.get_value()

    def _CalcPolicy(self, context: Context, output: AbstractValue) -> None:
        known = self._learner(context)
        if known.task is None or known.learning is None:
            output.set_value(RoutePolicy.nothing(self._config.rewards))
        else:
            output.set_value(RoutePolicy.of(known.task, known.learning.q))

    def _CalcLearning(self, context: Context, output: AbstractValue) -> None:
        known = self._learner(context)
        progress = LearningProgress(known.status, known.reason)
        if known.learning is not None:
            of = known.learning
            progress = replace(
                progress,
                episodes=of.episodes,
                steps=of.steps,
                gap=known.gap,
                curve_motions=of.curve_motions,
                curve_rewards=of.curve_rewards,
            )
        output.set_value(progress)
