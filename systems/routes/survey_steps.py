"""The survey loop as a state machine: look, choose a goal, learn, offer, drive, and at the end the way home."""

from dataclasses import replace

import numpy as np

from .find_routes import blocked_at
from .frontiers import View, ViewGoal, find_goals, gain_of, hiding_cells, open_questions
from .route import Route
from .route_config import RoutesConfig
from .route_grid import RouteGrid
from .survey_state import LoopState, Surroundings, SurveyLoopConfig

# [m], [rad] A robot that stays within this has not moved.
_STILL = 0.1


def next_state(
    state: LoopState, now: float, here: Surroundings, config: SurveyLoopConfig, routes: RoutesConfig | None = None
) -> LoopState:
    """The state after one more look at the surroundings at time `now` [s]; the same object when nothing changes."""
    spent = now - state.since

    def to(phase: str, **changes: object) -> LoopState:
        return replace(state, phase=phase, since=now, **changes)  # type: ignore[arg-type]

    if state.phase not in ("wait", "done"):
        if here.mode != "autonomous":
            if state.phase == "held":
                return state
            return to("held", view=None, offers=(), chosen=-1, held=state.held + 1)
        if state.phase == "held":  # the robot may be anywhere now
            return to("choose")
    if state.phase == "wait":
        if here.grid.blocked.all():
            return state
        x, y, heading = here.pose.tolist()
        return to("look", home=(x, y), view=View(x, y, heading))
    if state.phase == "look":
        return _looked(state, now, here, config)
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
    if state.phase == "back":
        return to("choose") if spent >= config.back_time else state
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
        if now - state.since < config.patience:
            return state
        return replace(state, phase="done", since=now, reason="no free ground around the robot; no way home", view=None)
    reason = state.reason
    if not reason and now >= config.time_budget:
        reason = "the time budget is over"
    if not reason and state.failures > config.most_failures:
        reason = "no way leads to what is left"
    goals: tuple[ViewGoal, ...] = ()
    if not reason:
        hiding = hiding_cells(here.grid, here.voxels, config.frontiers)
        goals = find_goals(here.grid, start, hiding, state.views, config.frontiers, routes, here.interest)
        if not goals:
            reason = "nothing reachable is unseen"
    if reason:
        if state.home is not None and np.hypot(*(np.array(state.home) - here.pose[:2])) <= config.snap:
            return replace(state, phase="done", since=now, returned=True, reason=reason, view=None)
        if state.homeward and state.failures > config.most_failures:
            return replace(state, phase="done", since=now, reason=f"{reason}; no way home", view=None)
        if state.homeward and state.failures and now - state.since < config.off_time:  # the next map may know better
            return state
        home = None if state.home is None else _snapped(np.array([*state.home, 0.0]), here.grid, config.snap)
        way_home = (np.nan, np.nan) if home is None else (float(home[0]), float(home[1]))
        place = (float(start[0]), float(start[1]), float(start[2]))
        failures = state.failures if state.homeward else 0
        return replace(
            state,
            phase="learn",
            since=now,
            homeward=True,
            way_home=way_home,
            view=None,
            start=place,
            reason=reason,
            failures=failures,
        )
    view = goals[0].view
    state = replace(state, since=now, view=view, gain=goals[0].gain, judged=here.interest)
    if np.hypot(view.x - start[0], view.y - start[1]) < here.grid.cell:
        return replace(state, phase="face")
    return replace(state, phase="learn", start=(float(start[0]), float(start[1]), float(start[2])))


def _driven(state: LoopState, now: float, here: Surroundings, config: SurveyLoopConfig) -> LoopState:
    spent, route = now - state.since, state.route
    ended = replace(state, since=now, offers=(), chosen=-1)
    # The follower notices a new route at its next decision: until then it still speaks of the last one.
    if here.driving == "arrived" and spent >= config.settle_time:
        ended = replace(ended, legs=state.legs + 1)
        if state.homeward:
            return replace(ended, phase="done", returned=True)
        return replace(ended, phase="face")
    x, y, heading = here.pose.tolist()
    since, *last = state.moved
    turned = abs(heading_error(last[2], here.pose)) if np.isfinite(last[2]) else np.inf
    if not (np.hypot(x - last[0], y - last[1]) < _STILL and turned < _STILL) or since < state.since:
        state = replace(state, moved=(now, x, y, heading))
    elif now - since > config.stall_time:
        return replace(_given_up(ended, now, config), phase="back", stalled=state.stalled + 1)
    if (here.driving == "off the route" and spent > config.off_time) or spent > config.slow * route.time_s + 10:
        return _given_up(ended, now, config)
    if closed_ahead(route, here.grid, here.pose):
        return replace(ended, phase="choose", closed=state.closed + 1)
    if state.view is not None and here.interest is not state.judged:
        if _gain(state.view, state, here, config) < min(config.frontiers.min_gain, config.keep_gain * state.gain):
            return replace(ended, phase="choose", view=None, passed=state.passed + 1)
        return replace(state, judged=here.interest)
    return state


def _looked(state: LoopState, now: float, here: Surroundings, config: SurveyLoopConfig) -> LoopState:
    """A look ends when its time is over, or earlier when a newer map leaves nothing to ask there."""
    spent = now - state.since
    if spent >= config.frontiers.look_time:
        # What was seen is what the robot looked at, not what it meant to. What it did not tell it never will.
        view = View(*here.pose.tolist())
        return replace(state, phase="choose", since=now, views=(*state.views, view), looks=state.looks + 1, view=None)
    if here.interest is None or here.interest is state.judged or spent < config.settle_time:
        return state
    view = View(*here.pose.tolist())
    if _gain(view, state, here, config) < 0.5 * config.frontiers.min_gain:
        # Looking there again would tell nothing either.
        again = state.short is not None and _alike(view, state.short)
        views = (*state.views, view) if again else state.views
        return replace(state, phase="choose", since=now, looks=state.looks + 1, view=None, views=views, short=view)
    return replace(state, judged=here.interest)


def _alike(a: View, b: View) -> bool:
    turn = abs(np.angle(np.exp(1j * (a.heading - b.heading))))
    return bool(np.hypot(a.x - b.x, a.y - b.y) < 0.3 and turn < 0.3)


def _gain(view: View, state: LoopState, here: Surroundings, config: SurveyLoopConfig) -> float:
    """What a look would tell by the newest map [bit m²]."""
    hiding = hiding_cells(here.grid, here.voxels, config.frontiers)
    questions = open_questions(here.grid, hiding, state.views, here.interest, config.frontiers)
    return gain_of(view, questions, here.grid, hiding, config.frontiers)


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


def _snapped(pose: np.ndarray, grid: RouteGrid, reach: float) -> np.ndarray | None:
    """`pose`, moved to the nearest free cell when its own is not free; None when that is farther than `reach`."""
    if grid.contains(pose[:2]) and not grid.blocked[tuple(grid.index_of(pose[:2]))]:
        return pose
    cell = grid.nearest_free(pose[:2])
    if cell is None:
        return None
    xy = grid.centre_of(cell)
    return np.array([*xy, pose[2]]) if np.hypot(*(xy - pose[:2])) <= reach else None
