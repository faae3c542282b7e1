"""The survey loop as a state machine: look, choose a goal, learn, offer, drive, and at the end the way home."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from ..config import quantity
from .find_routes import blocked_at
from .frontiers import FrontierConfig, View, ViewGoal, find_goals, hiding_cells
from .route import Route
from .route_config import RoutesConfig
from .route_grid import RouteGrid
from .voxels import Voxels

PHASES = ("wait", "choose", "learn", "offer", "drive", "face", "look", "done")
OPERATORS = ("auto", "prompt")


@dataclass(kw_only=True)
class SurveyLoopConfig:
    """How a survey without a tour decides where to look, and when it goes home."""

    # "auto" takes the cheapest route, "prompt" waits for the operator's `choice`.
    operator: str = quantity("auto", choices=OPERATORS)
    # [s] From this simulated time on the robot goes home.
    time_budget: float = quantity(480.0, unit="s", above=0)
    # [s] How long a route is learnt at most, and how long at least: the learner must have noticed the goal.
    learn_time: float = quantity(10.0, unit="s", above=0)
    settle_time: float = quantity(0.5, unit="s", low=0)
    # [s] A leg ends without arrival after this multiple of its predicted time, and when the path was left this long.
    slow: float = quantity(3.0, low=1)
    off_time: float = quantity(3.0, unit="s", low=0)
    # Goals without a way that are tried one after the other before the robot goes home, and tries at the way home.
    most_failures: int = quantity(8, low=0)
    # [m] The robot may stand this far from a free cell: routes begin at the nearest.
    snap: float = quantity(0.5, unit="m", above=0)
    # [rad] Largest error of the heading at a look. [1/s], [rad/s] Gain and yaw rates of turning to it.
    face_tolerance: float = quantity(0.08, unit="rad", above=0)
    turn_gain: float = quantity(1.5, unit="1/s", above=0)
    turn_rate: float = quantity(0.8, unit="rad/s", above=0)
    min_turn_rate: float = quantity(0.15, unit="rad/s", low=0)
    # [m], [rad] A rise of the route this steep within this distance ahead calls for the preset `climb`.
    climb_ahead: float = quantity(0.6, unit="m", above=0)
    climb_slope: float = quantity(0.25, unit="rad", above=0)
    # [s] Period of the decisions.
    period: float = quantity(0.2, unit="s", above=0)
    frontiers: FrontierConfig = field(default_factory=FrontierConfig)


@dataclass(frozen=True, eq=False)
class LoopState:
    """Where the survey is; read-only.

    Attributes:
        phase: of `PHASES`. since: when it began [s].
        home: x, y of the start [m]; None before the first map.
        view: the look that is the goal; None without. homeward: whether the goal is home.
        start: (3,) pose at which routes to the goal begin, NaN without goal [m, m, rad].
        views: looks taken, and goals that were given up.
        offers: routes that the operator may choose from. chosen: which one is driven, -1 for none yet.
        legs: legs driven to their end. offered: routes offered so far. closed: legs ended by a newer map.
        failures: goals without a way, one after the other. returned: whether the robot is back home.
        reason: why the survey goes home or is done.
    """

    phase: str = "wait"
    since: float = 0.0
    home: tuple[float, float] | None = None
    view: View | None = None
    homeward: bool = False
    start: tuple[float, float, float] = (np.nan, np.nan, np.nan)
    views: tuple[View, ...] = ()
    offers: tuple[Route, ...] = ()
    chosen: int = -1
    legs: int = 0
    offered: int = 0
    closed: int = 0
    failures: int = 0
    returned: bool = False
    reason: str = ""

    def __deepcopy__(self, memo: dict) -> "LoopState":
        return self

    @property
    def route(self) -> Route:
        """The route that is driven now, one without points otherwise."""
        return self.offers[self.chosen] if self.phase == "drive" else Route()

    @property
    def goal(self) -> tuple[float, float]:
        """x, y [m], NaN without."""
        if self.homeward and self.home is not None:
            return self.home
        return (np.nan, np.nan) if self.view is None else (self.view.x, self.view.y)


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What the loop decides by.

    Attributes:
        pose: (3,) x, y, heading in M. grid, voxels: of the newest map.
        learning: status of the learner. routes: computes the routes from `start` to `goal` of the state.
        driving: status of the path follower. choice: index of the operator's choice, negative as long as there is none.
    """

    pose: np.ndarray
    grid: RouteGrid
    voxels: Voxels
    learning: str
    routes: Callable[[], tuple[Route, ...]]
    driving: str
    choice: int = -1


def next_state(
    state: LoopState, now: float, here: Surroundings, config: SurveyLoopConfig, routes: RoutesConfig | None = None
) -> LoopState:
    """The state after one more look at the surroundings at time `now` [s]; the same object when nothing changes."""
    spent = now - state.since

    def to(phase: str, **changes: object) -> LoopState:
        return replace(state, phase=phase, since=now, **changes)  # type: ignore[arg-type]

    if state.phase == "wait":
        if here.grid.blocked.all():
            return state
        x, y, heading = here.pose.tolist()
        return to("look", home=(x, y), view=View(x, y, heading))
    if state.phase == "look":
        assert state.view is not None
        if spent < config.frontiers.look_time:
            return state
        # What was seen is what the robot looked at, not what it meant to.
        return to("choose", views=(*state.views, View(*here.pose.tolist())), view=None)
    if state.phase == "choose":
        return _chosen(state, now, here, config, routes)
    if state.phase == "learn":
        if spent < config.settle_time or (here.learning in ("learning",) and spent < config.learn_time):
            return state
        offers = here.routes()
        if not offers:
            return _given_up(state, now, config)
        return to("offer", offers=offers, chosen=-1, offered=state.offered + len(offers), failures=0)
    if state.phase == "offer":
        if config.operator == "prompt":
            return to("drive", chosen=here.choice) if 0 <= here.choice < len(state.offers) else state
        cheapest = min(range(len(state.offers)), key=lambda i: state.offers[i].cost)
        return to("drive", chosen=cheapest)
    if state.phase == "drive":
        return _driven(state, now, here, config)
    if state.phase == "face":
        assert state.view is not None
        turned = abs(heading_error(state.view.heading, here.pose)) < config.face_tolerance
        return to("look") if turned or spent > 2 * np.pi / config.min_turn_rate else state
    return state


def heading_error(heading: float, pose: np.ndarray) -> float:
    """From the robot's heading to another, in (-pi, pi] [rad]."""
    return float(np.angle(np.exp(1j * (heading - pose[2]))))


def climbs(route: Route, s: float, config: SurveyLoopConfig) -> bool:
    """Whether the known heights rise steeply within `climb_ahead` after arc length `s` [m]."""
    known = np.isfinite(route.z)
    if not known.any():
        return False
    ahead = s + np.arange(0.0, config.climb_ahead + 0.01, 0.1)
    z = np.interp(ahead, route.arc_length[known], route.z[known])
    return bool((z.max() - z[0]) > np.tan(config.climb_slope) * config.climb_ahead)


def _chosen(
    state: LoopState, now: float, here: Surroundings, config: SurveyLoopConfig, routes: RoutesConfig | None
) -> LoopState:
    start = _snapped(here.pose, here.grid, config.snap)
    if start is None:  # the next map may know better
        return replace(state, homeward=True, reason="no free ground around the robot") if _late(state, now) else state
    reason = state.reason
    if not reason and now >= config.time_budget:
        reason = "the time budget is over"
    if not reason and state.failures > config.most_failures:
        reason = "no way leads to what is left"
    goals: tuple[ViewGoal, ...] = ()
    if not reason:
        hiding = hiding_cells(here.grid, here.voxels, config.frontiers)
        goals = find_goals(here.grid, start, hiding, state.views, config.frontiers, routes)
        if not goals:
            reason = "nothing reachable is unseen"
    if reason:
        if state.home is not None and np.hypot(*(np.array(state.home) - here.pose[:2])) <= config.snap:
            return replace(state, phase="done", since=now, returned=True, reason=reason, view=None)
        if state.homeward and state.failures > config.most_failures:
            return replace(state, phase="done", since=now, reason=f"{reason}; no way home", view=None)
        place = (float(start[0]), float(start[1]), float(start[2]))
        failures = state.failures if state.homeward else 0
        return replace(
            state, phase="learn", since=now, homeward=True, view=None, start=place, reason=reason, failures=failures
        )
    view = goals[0].view
    if np.hypot(view.x - start[0], view.y - start[1]) < here.grid.cell:
        return replace(state, phase="face", since=now, view=view)
    return replace(
        state, phase="learn", since=now, view=view, start=(float(start[0]), float(start[1]), float(start[2]))
    )


def _driven(state: LoopState, now: float, here: Surroundings, config: SurveyLoopConfig) -> LoopState:
    spent, route = now - state.since, state.route
    ended = replace(state, since=now, offers=(), chosen=-1)
    # The follower notices a new route at its next decision: until then it still speaks of the last one.
    if here.driving == "arrived" and spent >= config.settle_time:
        ended = replace(ended, legs=state.legs + 1)
        if state.homeward:
            return replace(ended, phase="done", returned=True)
        return replace(ended, phase="face")
    if (here.driving == "off the route" and spent > config.off_time) or spent > config.slow * route.time_s + 10:
        return _given_up(ended, now, config)
    if closed_ahead(route, here.grid, here.pose):
        return replace(ended, phase="choose", closed=state.closed + 1)
    return state


def closed_ahead(route: Route, grid: RouteGrid, pose: np.ndarray) -> bool:
    """Whether a newer map closes what is still to be driven, from a robot's length on."""
    s, _ = route.nearest(pose[:2])
    left = route.xy[route.arc_length > s + 0.5]
    return len(left) > 1 and blocked_at(Route(xy=left, z=np.zeros(len(left))), grid) is not None


def _given_up(state: LoopState, now: float, config: SurveyLoopConfig) -> LoopState:
    """Chooses anew; a look that no way leads to counts as taken, so that the survey ends."""
    views = state.views if state.view is None else (*state.views, state.view)
    return replace(
        state, phase="choose", since=now, views=views, view=None, offers=(), chosen=-1, failures=state.failures + 1
    )


def _late(state: LoopState, now: float) -> bool:
    return now - state.since > 60.0 and not state.homeward


def _snapped(pose: np.ndarray, grid: RouteGrid, reach: float) -> np.ndarray | None:
    """`pose`, moved to the nearest free cell when its own is not free; None when that is farther than `reach`."""
    if grid.contains(pose[:2]) and not grid.blocked[tuple(grid.index_of(pose[:2]))]:
        return pose
    cell = grid.nearest_free(pose[:2])
    if cell is None:
        return None
    xy = grid.centre_of(cell)
    return np.array([*xy, pose[2]]) if np.hypot(*(xy - pose[:2])) <= reach else None
