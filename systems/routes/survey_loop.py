"""LeafSystem that runs a survey without a tour: look, choose, learn, offer, drive, again, then home."""

from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, EventStatus, LeafSystem, State

from ..config import check_config
from ..ports import eval_typed, weak_method
from ..tracking import planar_pose
from .route import Route
from .route_config import RoutesConfig
from .route_grid import RouteGrid
from .route_learner import LearningProgress
from .survey_state import LoopState, Surroundings, SurveyLoopConfig
from .survey_steps import climbs, heading_error, next_state
from .voxels import Voxels


class SurveyLoop(LeafSystem):
    """
    .. pydrake_system::

        name: SurveyLoop
        input_ports:
        - route_grid
        - voxels
        - interest
        - X_MB
        - learning
        - routes
        - follower_status
        - follower_pose
        - follower_twist
        - choice
        - mode
        output_ports:
        - start
        - goal
        - route
        - offers
        - chosen
        - reference_pose
        - reference_twist
        - flipper_preset
        - phase
        - survey
        - done

    Decides where a survey goes, see `next_state`: it looks around, chooses the look that tells most for its time
    (`find_goals`), has the way learnt, offers the routes, drives the chosen one, turns to the heading of the look and
    stands still there. A route that a newer map closes, and a goal that was seen on the way, are given up and the goal
    chosen anew. A robot that is caught on something goes back a little. While somebody else drives the loop rests, and
    begins where the robot then is. When nothing reachable is unseen or the time budget ends, the robot goes home.

    - `route_grid` (`RouteGrid`), `voxels` (`Voxels`), `interest` (array (nx, ny) [bit], optional): the newest map, as
      from a `VoxelWorld`. `X_MB` (RigidTransform): base B in map M.
    - `learning` (`LearningProgress`), `routes` (tuple of `Route`): what a `RouteLearner` and `DistinctRoutes` say about
      `start` (3: x, y, heading [m, m, rad]) and `goal` (2: x, y [m]); NaN when there is nothing to learn, as under way.
    - `follower_status` (str), `follower_pose` (3), `follower_twist` (2): of a `PathFollower` that is given `route`
      (`Route`, without points unless it is to be driven).
    - `choice` (1): index of the route that the operator wants, negative as long as none; optional with `auto`.
    - `mode` (str, optional): who drives, as from a `ModeSwitch`; the loop rests unless it is "autonomous".
    - `offers` (tuple of `Route`), `chosen` (1): what the operator sees; -1 before the choice.
    - `reference_pose` (3), `reference_twist` (2): those of the follower while driving; turning on the spot or standing
      still [m, m, rad; m/s, rad/s] otherwise.
    - `flipper_preset` (str): `climb` before and on a steep rise of the route, else `auto`.
    - `phase` (str): one of `PHASES`; `survey` (`LoopState`): all of it; `done` (1): 1 at the end.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PortError: an input that is needed is not connected or of another type.
    """

    def __init__(self, config: SurveyLoopConfig | None = None, *, routes: RoutesConfig | None = None):
        """
        Args:
            routes: what ground can be driven over, as for `DistinctRoutes`.
        """
        super().__init__()
        self._config, self._routes = config or SurveyLoopConfig(), routes or RoutesConfig()
        check_config(self._config, key="loop")
        check_config(self._routes, key="routes")
        for name in ("route_grid", "voxels", "interest"):
            self.DeclareAbstractInputPort(name, AbstractValue.Make(object()))
        self._interest = self.GetInputPort("interest")
        pose = self.DeclareAbstractInputPort("X_MB", AbstractValue.Make(RigidTransform()))
        for name in ("learning", "routes"):
            self.DeclareAbstractInputPort(name, AbstractValue.Make(object()))
        self.DeclareAbstractInputPort("follower_status", Value[str]())
        follower = [self.DeclareVectorInputPort("follower_pose", 3), self.DeclareVectorInputPort("follower_twist", 2)]
        self._choice = self.DeclareVectorInputPort("choice", 1)
        self._mode = self.DeclareAbstractInputPort("mode", Value[str]())
        ticket = self.abstract_state_ticket(self.DeclareAbstractState(AbstractValue.Make(LoopState())))
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._config.period, 0.0, self._Decide)
        by_state = {ticket}
        self.DeclareVectorOutputPort("start", 3, self._CalcStart, by_state)
        self.DeclareVectorOutputPort("goal", 2, self._CalcGoal, by_state)
        self.DeclareAbstractOutputPort(
            "route", lambda: AbstractValue.Make(Route()), weak_method(self._CalcRoute), by_state
        )
        self.DeclareAbstractOutputPort(
            "offers", lambda: AbstractValue.Make(()), weak_method(self._CalcOffers), by_state
        )
        self.DeclareVectorOutputPort("chosen", 1, self._CalcChosen, by_state)
        by_follower = {ticket, pose.ticket(), *(port.ticket() for port in follower)}
        self.DeclareVectorOutputPort("reference_pose", 3, self._CalcReferencePose, by_follower)
        self.DeclareVectorOutputPort("reference_twist", 2, self._CalcReferenceTwist, by_follower)
        self.DeclareAbstractOutputPort(
            "flipper_preset", lambda: Value[str](), weak_method(self._CalcFlippers), {ticket, pose.ticket()}
        )
        self.DeclareAbstractOutputPort("phase", lambda: Value[str](), weak_method(self._CalcPhase), by_state)
        self.DeclareAbstractOutputPort(
            "survey", lambda: AbstractValue.Make(LoopState()), weak_method(self._CalcSurvey), by_state
        )
        self.DeclareVectorOutputPort("done", 1, self._CalcDone, by_state)

    @staticmethod
    def _held(context: Context) -> LoopState:
        held: Any = context.get_abstract_state(0)
        return held.get_value()

    def _pose(self, context: Context) -> np.ndarray:
        return planar_pose(eval_typed(self, context, "X_MB", RigidTransform))

    def _Decide(self, context: Context, state: State) -> EventStatus:
        before = self._held(context)
        given = self._choice.HasValue(context)
        chosen = int(eval_typed(self, context, "choice", np.ndarray)[0]) if given else -1
        here = Surroundings(
            pose=self._pose(context),
            grid=eval_typed(self, context, "route_grid", RouteGrid),
            voxels=eval_typed(self, context, "voxels", Voxels),
            learning=eval_typed(self, context, "learning", LearningProgress).status,
            routes=lambda: eval_typed(self, context, "routes", tuple),
            driving=eval_typed(self, context, "follower_status", str),
            choice=chosen,
            interest=eval_typed(self, context, "interest", np.ndarray) if self._interest.HasValue(context) else None,
            mode=eval_typed(self, context, "mode", str) if self._mode.HasValue(context) else "autonomous",
        )
        after = next_state(before, context.get_time(), here, self._config, self._routes)
        if after is before:
            return EventStatus.DidNothing()
        state.get_mutable_abstract_state(0).set_value(after)
        return EventStatus.Succeeded()

    def _CalcStart(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array(self._held(context).start))

    def _CalcGoal(self, context: Context, output: BasicVector) -> None:
        held = self._held(context)
        output.SetFromVector(np.array(held.goal if held.phase in ("learn", "offer") else (np.nan, np.nan)))

    def _CalcRoute(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._held(context).route)

    def _CalcOffers(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._held(context).offers)

    def _CalcChosen(self, context: Context, output: BasicVector) -> None:
        output[0] = self._held(context).chosen

    def _CalcReferencePose(self, context: Context, output: BasicVector) -> None:
        held = self._held(context)
        if held.phase == "drive":
            output.SetFromVector(eval_typed(self, context, "follower_pose", np.ndarray))
            return
        pose = self._pose(context)
        if held.phase == "face" and held.view is not None:
            pose[2] = held.view.heading
        output.SetFromVector(pose)

    def _CalcReferenceTwist(self, context: Context, output: BasicVector) -> None:
        held, config = self._held(context), self._config
        twist = np.zeros(2)
        if held.phase == "drive":
            twist = eval_typed(self, context, "follower_twist", np.ndarray)
        elif held.phase == "back":
            twist[0] = -config.back_speed
        elif held.phase == "face" and held.view is not None:
            turn = heading_error(held.view.heading, self._pose(context))
            slowest = min(config.min_turn_rate, config.turn_rate)
            twist[1] = np.copysign(np.clip(abs(config.turn_gain * turn), slowest, config.turn_rate), turn)
        output.SetFromVector(twist)

    def _CalcFlippers(self, context: Context, output: AbstractValue) -> None:
        route = self._held(context).route
        steep = len(route.xy) and climbs(route, route.nearest(self._pose(context)[:2])[0], self._config)
        output.set_value("climb" if steep else "auto")

    def _CalcPhase(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._held(context).phase)

    def _CalcSurvey(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._held(context))

    def _CalcDone(self, context: Context, output: BasicVector) -> None:
        output[0] = float(self._held(context).phase == "done")
