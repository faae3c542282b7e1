"""Backing up, and what makes the controller do so: it is stuck or caught, has no room to turn, or stands on a slope
that a turn would slide it down."""

from dataclasses import replace

import numpy as np

from .ability import Ability
from .vfh_choice import room_behind, turn_depth, wrapped
from .vfh_state import BACKING, DRIVING, NOWHERE, TURNING, Command, Decision, Sight, VfhConfig, VfhState
from .wavefront import ALWAYS

# A robot keeps no more marks than this; the oldest goes first.
_MOST_MARKS = 64
# [m], [rad] Poses of the track are so far apart; one that is turned farther against the last was turned to on the spot.
_TRACK_STEP, _TRACK_TURN = 0.05, 0.5
# As much of the track is kept, more than it backs up.
_MOST_TRACK = 64
# [m] It backs up towards the point of its track that is so far away.
_AHEAD = 0.4


def mark(state: VfhState, sight: Sight, heading: float, ahead: float, ability: Ability, kind: float) -> VfhState:
    """Takes a disc `ahead` [m] in a direction in M [rad] for an obstacle, see `spread_costs`."""
    x, y = sight.pose[:2] + ahead * np.array([np.cos(heading), np.sin(heading)])
    disc = (float(x), float(y), max(0.5 * min(ability.footprint), 0.15), kind)
    return replace(state, marks=(*state.marks, disc)[-_MOST_MARKS:], turned=0.0, held=NOWHERE)


def stuck(state: VfhState, sight: Sight, config: VfhConfig) -> bool:
    """Whether it was told to move for long, and did not."""
    return sight.time - state.anchor[3] > config.stuck_time


def free(state: VfhState, sight: Sight, ability: Ability, config: VfhConfig) -> Decision:
    """Was told to move and did not: what is ahead is marked, and the robot backs up; if it turned, the other way. If it
    backed up, it does so no farther."""
    anchor = (*state.anchor[:3], sight.time)
    if state.status == DRIVING and np.isfinite(state.aim):
        state = mark(state, sight, state.aim, 0.5 * ability.footprint[0] + 0.1, ability, ALWAYS)
    state = replace(state, anchor=anchor, side=-state.side, aim=np.nan)
    if state.status == BACKING:
        return replace(state, back_to=0.0), Command()
    if state.status in (DRIVING, TURNING) and room_behind(sight.obstacles, ability.footprint):
        # Who could not turn hangs: both tracks are to pull alike.
        return back_up(state, sight, config.back_distance, config, on_track=state.status == DRIVING)
    return state, Command()


def let_go(state: VfhState, sight: Sight, ability: Ability, config: VfhConfig) -> Decision:
    """Something holds one side back and turns the robot: that side's front is marked, and the robot backs up."""
    side, (length, width) = float(np.sign(state.astray)), ability.footprint
    at = complex(0.25 * length, 0.5 * side * width)
    state = mark(state, sight, sight.pose[2] + float(np.angle(at)), abs(at), ability, ALWAYS)
    state = replace(state, astray=0.0, aim=np.nan, anchor=(*state.anchor[:3], sight.time))
    if room_behind(sight.obstacles, ability.footprint):
        return back_up(state, sight, config.back_distance, config, on_track=True)
    return state, Command()


def back_up(state: VfhState, sight: Sight, distance: float, config: VfhConfig, *, on_track: bool = False) -> Decision:
    """Begins to back up by `distance` [m], straight or on its track.

    Who wants room for a turn goes straight: on its track it would undo what it has turned already, and come again.
    """
    x, y, _ = (float(value) for value in sight.pose)
    anchor, start = (*state.anchor[:3], sight.time), (x, y, sight.time)
    state = replace(state, status=BACKING, anchor=anchor, back_from=start, back_to=distance, on_track=on_track)
    return retrace(state, sight, config)


def with_track(state: VfhState, sight: Sight) -> VfhState:
    """The state with the track until now: longer while it drives, forgotten after a turn on the spot."""
    track, (x, y, heading) = state.track, (float(value) for value in sight.pose)
    if state.status == BACKING:
        return state
    if track and abs(wrapped(heading - track[-1][2])) > _TRACK_TURN:
        track = ()
    if track and np.hypot(x - track[-1][0], y - track[-1][1]) < _TRACK_STEP:
        return state
    return replace(state, track=(*track, (x, y, heading))[-_MOST_TRACK:])


def retrace(state: VfhState, sight: Sight, config: VfhConfig) -> Decision:
    """Backs up: straight, or with `on_track` on the track that it came on, which was free, by pure pursuit, where
    that is behind it.

    The arc to a point (x, y) in the heading frame has the curvature 2y / (x² + y²), forwards and backwards (Coulter,
    "Implementation of the Pure Pursuit Path Tracking Algorithm", 1992).
    """
    track = state.track
    while track and np.hypot(track[-1][0] - sight.pose[0], track[-1][1] - sight.pose[1]) < _AHEAD:
        track = track[:-1]
    omega = 0.0
    if track and state.on_track:
        away, (c, s) = np.array(track[-1][:2]) - sight.pose[:2], (np.cos(sight.pose[2]), np.sin(sight.pose[2]))
        x, y = away @ [c, s], away @ [-s, c]
        if -x > abs(y):
            omega = float(-config.back_speed * 2 * y / (x * x + y * y))
    return replace(state, track=track), Command(v_r=-config.back_speed, omega_r=omega)


def off_the_slope(state: VfhState, sight: Sight, ability: Ability, config: VfhConfig) -> Decision | None:
    """Backs up from where a turn would slide it to where it does not half as far, at most by `longest_back`.

    What is ahead is marked: a way that bends there is none.
    """
    if not _slides(sight, ability, config.longest_slide) or not room_behind(sight.obstacles, ability.footprint):
        return None
    if not state.backed:
        state = mark(state, sight, sight.pose[2], 0.5 * ability.footprint[0] + 0.1, ability, ALWAYS)
        return back_up(replace(state, backed=True, aim=np.nan), sight, config.longest_back, config, on_track=True)
    if _backed_far(state, sight, config):
        return None
    # On a crest it stood level, and slides as soon as it turns. Who does no more than that, to and fro, is stuck.
    after, command = back_up(state, sight, state.back_to, config, on_track=True)
    return replace(after, back_from=state.back_from, anchor=state.anchor), command


def backed_enough(state: VfhState, sight: Sight, ability: Ability, config: VfhConfig) -> bool:
    """Whether to stop backing up: there is room to turn now if it was for that, it went far enough, or it cannot."""
    level = not _slides(sight, ability, 0.5 * config.longest_slide)
    for_room = state.backed and level and room_to_turn(sight, state.side * np.pi / 2, ability)
    return for_room or _backed_far(state, sight, config) or not room_behind(sight.obstacles, ability.footprint)


def _backed_far(state: VfhState, sight: Sight, config: VfhConfig) -> bool:
    """Whether it backed up as far as it was to, or had the time to and did not get there."""
    x, y, since = state.back_from
    late = sight.time - since > 2 * state.back_to / config.back_speed + 1.0
    return late or float(np.hypot(sight.pose[0] - x, sight.pose[1] - y)) >= state.back_to


def room_to_turn(sight: Sight, turn: float, ability: Ability) -> bool:
    """Whether a turn on the spot [rad] touches nothing, as far as it slides too."""
    return turn_depth(sight.obstacles, ability.footprint, turn, slide_of(sight, ability)) <= 0


def _slides(sight: Sight, ability: Ability, limit: float) -> bool:
    return float(np.hypot(*slide_of(sight, ability))) > limit


def slide_of(sight: Sight, ability: Ability) -> tuple[float, float]:
    """Downhill, as far as a turn slides the robot that is aligned with it [m/rad]."""
    return ability.turn_slide * sight.downhill[0], ability.turn_slide * sight.downhill[1]
