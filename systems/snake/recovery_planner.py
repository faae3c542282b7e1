"""Ways out for a snake that is stuck: what could be tried, and which of it is best after a rehearsal (row S1-g)."""

from dataclasses import dataclass, field, replace

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, LeafSystem

from ..config import check_config, quantity
from ..ports import eval_typed, weak_method
from .posture import tilt_rotation
from .recovery_motion import RecoveryCommand, middle_in_head
from .snake_body import SnakeBody
from .snake_pilot import Move
from .stuck_rules import Diagnosis


@dataclass(kw_only=True)
class RecoveryPlannerConfig:
    """What is proposed."""

    # Half of a segment, in units before and behind the one that is stuck, with which recoveries are proposed first.
    half_segment: int = quantity(2, low=1)
    # Heights of the target over where the middle of the segment is. With the slack of one unit, five straight units
    # stand 0.24 m high in the middle: a lower target is passed on the way.
    lifts: list[float] = quantity([0.24, 0.16], unit="m", min_length=1)
    # How far the middle of the segment moves ahead: half of what the control point does.
    forward: float = quantity(0.09, unit="m")
    # Speed of driving moves, and the wheel torque of the move with more of it.
    speed: float = quantity(0.1, unit="m/s", above=0.0)
    more_torque: float = quantity(0.9, unit="N m", above=0.0)
    # A proposal that in its rehearsal drives on for less, comes nearer to tipping over or nearer to the end of a
    # joint's range, or moves the head by more, is not taken.
    min_advance: float = quantity(0.4, unit="m", low=0.0)
    min_tip_margin: float = quantity(0.01, unit="m")
    min_joint_margin: float = quantity(0.0, unit="rad")
    # What a second is worth against a metre of advance, of margin and of head motion.
    second_cost: float = quantity(0.02, unit="m/s", low=0.0)


@dataclass(frozen=True)
class Proposal:
    """Something to try.

    Attributes:
        name: of the kind of move. moves: one after the other, each with its time [s].
        cheap: whether an operator would try it first: it needs no segment and no target.
    """

    name: str
    moves: tuple[tuple[Move, float], ...]
    cheap: bool


@dataclass(frozen=True)
class Rehearsal:
    """How a proposal went on a copy of the model.

    Attributes:
        advance: driven on afterwards [m]. head_motion: of the head while it was carried out [m].
        tip_margin: smallest distance from tipping over [m]. joint_margin: smallest from the end of a range [rad].
        control_error: of the control point at the end [m], 0 for a cheap move.
        duration: of the moves [s]. reason: why it ended, in words.
    """

    advance: float
    head_motion: float
    tip_margin: float
    joint_margin: float
    control_error: float
    duration: float
    reason: str = ""


@dataclass(frozen=True)
class RankedProposal:
    """A proposal with what its rehearsal says.

    Attributes:
        score: the higher, the better; -inf when it is not to be taken, and `objection` says why.
    """

    proposal: Proposal
    rehearsal: Rehearsal
    score: float
    objection: str = ""


@dataclass(frozen=True)
class Proposals:
    """All that could be tried, best guess first.

    Attributes:
        diagnosis: that they are meant for.
    """

    diagnosis: Diagnosis = field(default_factory=Diagnosis)
    items: tuple[Proposal, ...] = ()


def propose(
    diagnosis: Diagnosis, angles: np.ndarray, rpy: np.ndarray, body: SnakeBody, config: RecoveryPlannerConfig
) -> Proposals:
    """What could free a snake that is stuck as `diagnosis` says; nothing when it is not stuck.

    Args:
        angles: (2n - 1,) measured joint angles [rad]. rpy: (3,) of the head [rad].
    """
    if not diagnosis.stuck:
        return Proposals(diagnosis)
    recoveries = recover_moves(diagnosis.unit, angles, rpy, body, config)
    cheap = cheap_moves(config)
    # A wedged bend or a belly on an edge often needs no more than another shape; a wheel that is blocked does.
    order = (*cheap, *recoveries) if diagnosis.kind in (2, 5) else (*recoveries, *cheap)
    return Proposals(diagnosis, order)


def recover_moves(
    unit: int, angles: np.ndarray, rpy: np.ndarray, body: SnakeBody, config: RecoveryPlannerConfig
) -> tuple[Proposal, ...]:
    """Null-space recoveries with segments around `unit` and targets above it."""
    R_HB = tilt_rotation(rpy)
    up, ahead = R_HB.T @ [0.0, 0.0, 1.0], R_HB.T @ [1.0, 0.0, 0.0]
    half, found = config.half_segment, []
    for shift, lift in [(0, lift) for lift in config.lifts] + [(1, config.lifts[0]), (-1, config.lifts[0])]:
        first = min(max(0, unit + shift - half), body.units - 1 - 2 * half)
        last = first + 2 * half
        if first < 0:
            continue
        middle = middle_in_head(angles, first, last, body.half_length)
        target = middle + config.forward * ahead + lift * up
        x, y, z = (float(v) for v in target)
        command = RecoveryCommand(first_unit=first, last_unit=last, target=(x, y, z))
        label = f"recover with units {first} to {last}, target {100 * lift:.0f} cm up"
        found.append(Proposal("recover", ((Move(kind="recover", recovery=command, label=label), 8.0),), False))
    unique = {item.moves[0][0].label: item for item in found}
    return tuple(unique.values())


def cheap_moves(config: RecoveryPlannerConfig) -> tuple[Proposal, ...]:
    """What an operator would try first."""
    v = config.speed
    back = Move(kind="wheels", speed=-v, label="reverse")
    relax = Move(kind="relax", label="relax the joints")
    push = Move(kind="wheels", speed=v, wheel_torque=config.more_torque, label="more wheel torque")
    go_on = Move(kind="shift", speed=v, label="shift the shape by command")
    return (
        Proposal("shift", ((go_on, 2.0),), True),
        Proposal("relax", ((relax, 1.2),), True),
        Proposal("reverse", ((back, 3.0),), True),
        Proposal("torque", ((push, 3.0),), True),
    )


def numbered(proposal: Proposal, first: int) -> list[tuple[Move, float]]:
    """The moves of a proposal with numbers from `first` on."""
    return [(replace(move, number=first + i), seconds) for i, (move, seconds) in enumerate(proposal.moves)]


def rank(rehearsed: list[tuple[Proposal, Rehearsal]], config: RecoveryPlannerConfig) -> list[RankedProposal]:
    """Best first: by how far it drives on, how far from tipping over it stays, how still the head, and how soon."""
    ranked = []
    for proposal, result in rehearsed:
        objection = object_to(result, config)
        score = min(result.advance, 1.0) + min(result.tip_margin, 0.1) - result.head_motion
        score -= config.second_cost * result.duration
        ranked.append(RankedProposal(proposal, result, -np.inf if objection else float(score), objection))
    return sorted(ranked, key=lambda item: -item.score)


def object_to(result: Rehearsal, config: RecoveryPlannerConfig) -> str:
    """Why a proposal is not to be taken, "" when it may be."""
    if not result.advance >= config.min_advance:
        return f"it drives on for only {result.advance:.2f} m"
    if result.tip_margin < config.min_tip_margin:
        return f"it comes within {1e3 * result.tip_margin:.0f} mm of tipping over"
    if result.joint_margin < config.min_joint_margin:
        return "a joint goes beyond its range"
    return ""


class RecoveryPlanner(LeafSystem):
    """
    .. pydrake_system::

        name: RecoveryPlanner
        input_ports:
        - diagnosis
        - joint_angles
        - rpy
        output_ports:
        - proposals

    Proposes ways out for a snake with n units. `diagnosis` is that of `StuckDetector`, `joint_angles` (2n - 1) [rad]
    and `rpy` (3) [rad] are measured. `proposals` is a `Proposals`: null-space recoveries with segment, control point
    and target around the unit that is stuck, and the cheap moves that an operator would try first: shifting the shape
    by command, relaxing, reversing, more wheel torque. It is empty while the robot is not stuck.

    Which of them is best is for a rehearsal on a copy of the model to say (`rank`): a diagram that can build such a
    copy does it.

    Raises `ConfigError` on values out of range and `PortError` when a port is not connected or carries another type.
    """

    def __init__(self, config: RecoveryPlannerConfig, *, body: SnakeBody):
        super().__init__()
        check_config(config, key="planner")
        self._config, self._body = config, body
        self.DeclareAbstractInputPort("diagnosis", AbstractValue.Make(Diagnosis()))
        self.DeclareVectorInputPort("joint_angles", 2 * body.units - 1)
        self.DeclareVectorInputPort("rpy", 3)
        self.DeclareAbstractOutputPort(
            "proposals", lambda: AbstractValue.Make(Proposals()), weak_method(self._CalcProposals)
        )

    def _CalcProposals(self, context: Context, output: AbstractValue) -> None:
        diagnosis = eval_typed(self, context, "diagnosis", Diagnosis)
        angles = eval_typed(self, context, "joint_angles", np.ndarray)
        rpy = eval_typed(self, context, "rpy", np.ndarray)
        if not (np.all(np.isfinite(angles)) and np.all(np.isfinite(rpy))):
            output.set_value(Proposals(diagnosis))  # nothing can be planned on a body whose shape is not known
            return
        output.set_value(propose(diagnosis, angles, rpy, self._body, self._config))
