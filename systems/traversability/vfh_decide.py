"""The decisions of the fuzzy VFH controller as a pure function from state and sight to state and command."""

from dataclasses import replace

import numpy as np

from .ability import Ability
from .vfh_back import (
    back_up,
    backed_enough,
    free,
    let_go,
    mark,
    retrace,
    stuck,
    with_track,
)
from .vfh_choice import (
    best_direction,
    nearest_to_goal,
    open_ahead,
    room_behind,
    wrapped,
)
from .vfh_moves import TO_AND_FRO, rest, steer, turn_on_spot
from .vfh_state import (
    ARRIVED,
    BACKING,
    DRIVING,
    LOOKING,
    NO_WAY,
    NOWHERE,
    TURNING,
    Command,
    Decision,
    Sight,
    VfhConfig,
    VfhState,
)
from .wavefront import ALWAYS, IF_UNSEEN

_FULL_TURN = 2 * np.pi
# [rad] Within this the robot looks into the direction it wants.
_ALIGNED = 0.15
# [m] What it saw from a spot it has seen from all around as far as this.
_AWAY = 0.5
# [m] A way that is kept to is done with so near to its point: on it, no direction leads there any more.
_THERE = 0.2
# [m] The ground before a goal so near is not seen any more.
_NEAR_GOAL = 1.0


def decide(state: VfhState, sight: Sight, ability: Ability, config: VfhConfig) -> Decision:
    """What to do now.

    In this order: stay at the goal; free itself when it is stuck; end a stretch of backing up; when remembered ground
    has no way to the goal, look around once and then say so; else drive, turn on the spot or back up, see `_go`.
    """
    goal = (float(sight.goal[0]), float(sight.goal[1]))
    if goal != state.goal:
        state = VfhState(goal=goal, marks=state.marks, track=state.track, index=state.index)
    left = float(np.hypot(*(sight.goal - sight.pose[:2])))
    if left <= config.tolerance * (2 if state.status == ARRIVED else 1):
        return rest(replace(state, status=ARRIVED), sight)
    if sight.time < config.start_time:
        return rest(replace(state, status=LOOKING), sight)
    if config.preset == "paper":
        return _paper(state, sight, ability, config)
    state = _watch(state, sight, config)
    if stuck(state, sight, config):
        return free(state, sight, ability, config)
    if state.status == BACKING and not backed_enough(state, sight, ability, config):
        return retrace(state, sight, config)
    if abs(state.astray) > np.deg2rad(config.caught_turn_deg):
        return let_go(state, sight, ability, config)
    if state.status == NO_WAY and state.again < config.confirmations:
        return rest(state, sight)
    if state.without > 1 or (sight.way is None and state.without > 0):
        return _look_around(state, sight, ability, config)
    if sight.way is None:
        return rest(replace(state, status=LOOKING), sight)
    return _go(state, sight, ability, config)


def _paper(state: VfhState, sight: Sight, ability: Ability, config: VfhConfig) -> Decision:
    """S3-c as it stands: the sub-goal is the far edge of the candidate nearest to the goal; without any it waits."""
    theta = sight.pose[2]
    R_HM = np.array([[np.cos(theta), np.sin(theta)], [-np.sin(theta), np.cos(theta)]])
    choice = nearest_to_goal(sight.histogram, R_HM @ (sight.goal - sight.pose[:2]))
    if choice is None:
        return replace(state, status=NO_WAY), Command()
    x, y = sight.pose[:2] + sight.histogram.far_edges[choice] @ R_HM
    heading = wrapped(theta + sight.histogram.directions[choice])
    subgoal, v_r = (float(x), float(y), heading), config.reference_share * ability.max_speed
    return replace(state, status=DRIVING), Command(subgoal, v_r, 0.0, float(sight.histogram.risk[choice]))


def _watch(state: VfhState, sight: Sight, config: VfhConfig) -> VfhState:
    """The state with what moved since the last decision, and the track."""
    x, y, heading = (float(value) for value in sight.pose)
    if np.isfinite(state.heading):
        turn = wrapped(heading - state.heading)
        state = replace(state, turned=state.turned + abs(turn), astray=_astray(state, turn, sight.yaw_rate, config))
    there = np.hypot(x - state.held[0], y - state.held[1]) < _THERE
    if there or not np.hypot(x - state.spot[0], y - state.spot[1]) < _AWAY:
        state = replace(state, turned=0.0, spot=(x, y), held=NOWHERE)
    moved = np.hypot(x - state.anchor[0], y - state.anchor[1])
    moved_or_turned = not (
        moved < config.stuck_distance and abs(wrapped(heading - state.anchor[2])) < np.deg2rad(config.stuck_turn_deg)
    )
    if moved_or_turned or state.status in (ARRIVED, NO_WAY):
        state = replace(state, anchor=(x, y, heading, sight.time))
    if sight.index != state.index:
        none = sight.way is None
        state = replace(state, without=state.without + 1 if none else 0, again=0 if none else state.again + 1)
    return with_track(replace(state, heading=heading, index=sight.index), sight)


def _astray(state: VfhState, turn: float, yaw_rate: float, config: VfhConfig) -> float:
    """How far it turned of late [rad] beyond what the drive was told to, or to the other side; a drive that turns less
    only slips. Positive to the left."""
    if state.status != DRIVING or not np.isfinite(yaw_rate):
        return 0.0
    told = yaw_rate * config.period
    beyond = turn - float(np.clip(turn, min(told, 0.0), max(told, 0.0)))
    return state.astray * float(np.exp(-config.period / config.caught_time)) + beyond


def _look_around(state: VfhState, sight: Sight, ability: Ability, config: VfhConfig) -> Decision:
    """No way is known: turns once to see all around, then says so when it is confirmed.

    Before a goal that is nearer than `_NEAR_GOAL` it backs up so far first, and looks again: what it remembers of
    ground so near may be dust, and cannot be seen from here.
    """
    if state.status != LOOKING:
        state = replace(state, status=LOOKING, turned=0.0, side=state.side or 1.0, aim=np.nan)
    if state.turned < _FULL_TURN:
        return turn_on_spot(state, sight, state.side * np.pi / 2, ability, config, LOOKING)
    if state.without >= config.confirmations:
        near = np.hypot(*(sight.goal - sight.pose[:2])) < _NEAR_GOAL
        if near and not state.looked_back and room_behind(sight.obstacles, ability.footprint):
            return back_up(replace(state, looked_back=True, backed=False), sight, _NEAR_GOAL, config)
        return rest(replace(state, status=NO_WAY, side=0.0, again=0), sight)
    return rest(state, sight)


def _go(state: VfhState, sight: Sight, ability: Ability, config: VfhConfig) -> Decision:
    """Steers for the point on the way: over the histogram, else over near remembered ground, else by a turn."""
    assert sight.way is not None
    if sight.field is not None and state.turned > TO_AND_FRO and np.isnan(state.held[0]):
        # A gap that is just wide enough opens when the robot turns away from it. Now it goes there, or marks it.
        state = replace(state, held=(float(sight.way[0]), float(sight.way[1])))
    if np.isfinite(state.held[0]):
        sight = replace(sight, way=np.array(state.held))
    assert sight.way is not None
    to_way = sight.way - sight.pose[:2]
    wanted = wrapped(np.arctan2(to_way[1], to_way[0]) - sight.pose[2])
    turning = state.status == TURNING and state.side != 0
    if abs(wanted) > np.deg2rad(config.turn_end_deg if turning else config.turn_start_deg):
        return turn_on_spot(state, sight, wanted, ability, config, TURNING)
    if sight.field is None:
        return _without_memory(state, sight, wanted, ability, config)
    directions = sight.histogram.directions
    half = 0.5 * float(directions[1] - directions[0]) if len(directions) > 1 else np.pi / 4
    choice = best_direction(sight, wanted, state.aim, config)
    away = np.inf if choice is None else abs(wrapped(directions[choice] - wanted))
    if choice is not None and away <= 1.2 * half:
        return _drive(state, sight, choice, wanted, half, ability, config)
    near = _near(state, sight, wanted, ability, config)
    if near is not None:
        return near
    if choice is not None and away <= np.deg2rad(config.detour_deg):
        return _drive(state, sight, choice, wanted, half, ability, config)
    if abs(wanted) > _ALIGNED:
        return turn_on_spot(state, sight, wanted, ability, config, TURNING)
    return _refused(state, sight, wanted, ability, config)


def _without_memory(state: VfhState, sight: Sight, wanted: float, ability: Ability, config: VfhConfig) -> Decision:
    """Takes the candidate nearest to the goal's direction; turns to one side until there is one, at most once around.

    Nothing is known of what is beside the robot, so that a turn to look ends only with a candidate well ahead.
    """
    looking = state.status in (LOOKING, NO_WAY)
    choice = best_direction(sight, 0.0 if looking else wanted, state.aim, config)
    most = np.deg2rad(config.turn_end_deg if looking else config.turn_start_deg)
    if choice is not None and abs(sight.histogram.directions[choice]) <= most:
        return _drive(state, sight, choice, float(sight.histogram.directions[choice]), 0.0, ability, config)
    if state.turned >= _FULL_TURN:
        return rest(replace(state, status=NO_WAY, again=0), sight)
    side = state.side or float(np.sign(wanted) or 1.0)
    return turn_on_spot(replace(state, side=side), sight, side * np.pi / 2, ability, config, LOOKING)


def _drive(
    state: VfhState, sight: Sight, choice: int, wanted: float, half: float, ability: Ability, config: VfhConfig
) -> Decision:
    """Drives within the chosen rectangle, as near to the wanted direction as its share of the histogram goes."""
    middle = float(sight.histogram.directions[choice])
    direction = middle + float(np.clip(wrapped(wanted - middle), -half, half))
    direction = direction if open_ahead(sight, direction) else middle
    reach = float(np.hypot(*sight.histogram.far_edges[choice]))
    risk = float(sight.histogram.risk[choice])
    return steer(state, sight, direction, reach, risk, ability, config)


def _near(state: VfhState, sight: Sight, wanted: float, ability: Ability, config: VfhConfig) -> Decision | None:
    """A short sub-goal over remembered ground, where a rectangle ahead reaches into what the way bends around."""
    if sight.field is None or sight.way is None:
        return None
    to_way = sight.way - sight.pose[:2]
    distance = float(np.hypot(*to_way))
    length = min(config.near, distance)
    cost, risk, known = sight.field.line(sight.pose[:2], sight.pose[:2] + length / max(distance, 1e-9) * to_way)
    # Not the risk decides but the price: it is finite where the robot may leave ground that it could not enter.
    if not known or not np.isfinite(cost):
        return None
    return steer(state, sight, wanted, length, risk, ability, config)


def _refused(state: VfhState, sight: Sight, wanted: float, ability: Ability, config: VfhConfig) -> Decision:
    """The histogram refuses what is remembered as passable or was not seen: after a while it is marked."""
    since = state.refused_since if np.isfinite(state.refused_since) else sight.time
    state = replace(state, refused_since=since)
    if sight.time - since < config.patience:
        return rest(replace(state, status=LOOKING), sight)
    ahead = 0.5 * ability.footprint[0] + 0.3
    heading = sight.pose[2] + wanted
    end = sight.pose[:2] + config.near * np.array([np.cos(heading), np.sin(heading)])
    all_seen = sight.field is not None and sight.field.line(sight.pose[:2], end)[2]
    state = mark(state, sight, heading, ahead, ability, ALWAYS if all_seen else IF_UNSEEN)
    return rest(replace(state, refused_since=np.nan, status=LOOKING), sight)
