"""The moves that the fuzzy VFH controller decides on: to steer, to turn on the spot, to stand."""

from dataclasses import replace

import numpy as np

from .ability import Ability
from .risk_map import IMPASSABLE
from .vfh_back import back_up, off_the_slope, room_to_turn, slide_of
from .vfh_choice import nearness, place_to_turn, wrapped
from .vfh_state import BACKING, DRIVING, LOOKING, TURNING, Command, Decision, Sight, VfhConfig, VfhState

# [rad] A robot that turned so far on one spot goes from one way to another and back.
TO_AND_FRO = 3 * np.pi


def steer(
    state: VfhState, sight: Sight, direction: float, reach: float, risk: float, ability: Ability, config: VfhConfig
) -> Decision:
    """Sets the sub-goal `reach` ahead, or at the goal where that is nearer, and the reference speed.

    The risk is that of the ground ahead or, where that is higher, of what stands beside it: a rectangle that holds a
    pillar is never chosen, and still the robot is to be slow near it (the paper's Fig. 12).
    """
    left = float(np.hypot(*(sight.goal - sight.pose[:2])))
    near = nearness(sight.obstacles, direction, ability.footprint, config.beside)
    risk = max(risk, config.beside_share * ability.risk_limit * near)
    aim = wrapped(direction + sight.pose[2])
    length = min(reach, left)
    x, y = sight.pose[:2] + length * np.array([np.cos(aim), np.sin(aim)])
    share = max(config.min_speed_share, 1 - min(risk, IMPASSABLE) / ability.risk_limit)
    slow = min(1.0, np.sqrt(2 * config.deceleration * left) / ability.max_speed)
    v_r = config.reference_share * ability.max_speed * share * slow
    anchor = state.anchor if state.status == DRIVING else (*state.anchor[:3], sight.time)
    state = replace(state, status=DRIVING, aim=aim, side=0.0, backed=False, looked_back=False, refused_since=np.nan)
    return replace(state, anchor=anchor), Command((float(x), float(y), aim), float(v_r), 0.0, risk)


def turn_on_spot(
    state: VfhState, sight: Sight, wanted: float, ability: Ability, config: VfhConfig, status: str
) -> Decision:
    """Turns on the spot towards `wanted` [rad, heading frame]; backs up first where it would touch something or slide.

    A turn keeps its side until the direction is less than a right angle away, so that a direction straight behind does
    not make it turn to and fro.
    """
    side = state.side if state.side and abs(wanted) > np.pi / 2 else float(np.sign(wanted) or 1.0)
    turn, slide = side * min(abs(wanted), np.pi / 2), slide_of(sight, ability)
    off = off_the_slope(replace(state, side=side), sight, ability, config)
    if off is not None:
        return off
    if not room_to_turn(sight, turn, ability):
        back = place_to_turn(sight.obstacles, ability.footprint, turn, slide, config.longest_back)
        if not state.backed and back > 0:
            return back_up(replace(state, side=side, backed=True, aim=np.nan), sight, back, config)
        # There is room where it came from: who turned to and fro keeps to its side.
        other = abs(wanted) > np.pi / 2 and state.turned < TO_AND_FRO
        if other and room_to_turn(sight, -side * np.pi / 2, ability):
            side = -side
    if state.status not in (TURNING, LOOKING, BACKING):
        state = replace(state, anchor=(*state.anchor[:3], sight.time))
    rate = float(np.clip(config.turn_gain * abs(wanted), config.min_turn_rate, ability.max_yaw_rate))
    return replace(state, status=status, side=side, aim=np.nan), Command(omega_r=side * rate)


def rest(state: VfhState, sight: Sight) -> Decision:
    """Stands still; that is not being stuck."""
    return replace(state, anchor=(*state.anchor[:3], sight.time), aim=np.nan), Command()
