"""A recovery from its start to its end, tick by tick: what `NullSpaceRecovery` does, without ports."""

from dataclasses import dataclass, field, replace

import numpy as np

from ..errors import ConfigError
from . import null_space_kernels as kernel
from .chain import ChainKinematics
from .chain_kernels import axle_rates
from .null_space_config import NullSpaceConfig
from .null_space_kernels import recovery_tick
from .recovery_motion import (
    RecoveryCommand,
    RecoveryMotion,
    joint_name,
    minimum_jerk,
    plan_motion,
    rotation_by,
    rotation_vector,
)
from .snake_body import SnakeBody


@dataclass(frozen=True, eq=False)
class RecoveryStatus:
    """How a recovery is getting on.

    Attributes:
        number: of the command. phase: "idle", "moving", "settling", "done", "stopped" or "refused".
        reason: why it is stopped or refused, or how it ended; in words.
        progress: of the control point on its way, 0 to 1.
        control_error: (6,) w_e - w_ref, position [m] and rotation vector [rad], from the measured angles.
        reference: (12,) w_ref in the frame A of the segment: position [m] and rotation row by row; NaN before a motion.
        distance: d, of the segment's middle joint from the target [m].
        manipulability: √det(J Jᵀ) of the segment [m³].
        joint_margin: smallest distance of a joint from the end of its range [rad]; negative beyond it.
    """

    number: int = 0
    phase: str = "idle"
    reason: str = ""
    progress: float = 0.0
    control_error: np.ndarray = field(default_factory=lambda: np.zeros(6))
    reference: np.ndarray = field(default_factory=lambda: np.full(12, np.nan))
    distance: float = np.nan
    manipulability: float = np.nan
    joint_margin: float = np.nan

    def __deepcopy__(self, memo: dict) -> "RecoveryStatus":
        return self


@dataclass(frozen=True, eq=False)
class RecoveryRun:
    """State of a recovery; read-only, so that Drake may share it.

    Attributes:
        command: that it carries out. motion: its plan; None when there is none.
        joints: (2n - 1,) commanded angles [rad]; NaN before the first command. wheels: (n,) commanded rates [rad/s].
        time: fraction of the duration that the motion has got to. elapsed: since the start [s].
        settling: how long it has been settling [s].
        patience: how long each trouble has lasted [s]: an error, a joint that lags, tipping, an angle that is missing.
        sag: (6,) by how much the control point was off the start of the motion, position [m] and rotation vector [rad].
    """

    command: RecoveryCommand
    status: RecoveryStatus
    joints: np.ndarray
    wheels: np.ndarray
    motion: RecoveryMotion | None = None
    settings: np.ndarray = field(default_factory=lambda: np.zeros(0))
    duration: float = 0.0
    time: float = 0.0
    elapsed: float = 0.0
    settling: float = 0.0
    patience: np.ndarray = field(default_factory=lambda: np.zeros(4))
    sag: np.ndarray = field(default_factory=lambda: np.zeros(6))

    def __deepcopy__(self, memo: dict) -> "RecoveryRun":
        return self


_ERROR, _LAG, _TIPPING, _BLIND = range(4)
"""Troubles, by their places in `RecoveryRun.patience`."""

_RUNAWAY = 1e3
"""[rad/s] no joint can go that fast; a law without bounds may ask for it near a singular pose."""


def idle_run(body: SnakeBody) -> RecoveryRun:
    """Before the first command."""
    return RecoveryRun(RecoveryCommand(), RecoveryStatus(), np.full(2 * body.units - 1, np.nan), np.zeros(body.units))


def start_run(
    run: RecoveryRun,
    command: RecoveryCommand,
    angles: np.ndarray,
    body: SnakeBody,
    config: NullSpaceConfig,
    held: np.ndarray | None = None,
) -> RecoveryRun:
    """Begins what `command` asks for from measured `angles` (2n - 1,), or refuses it and says why.

    Args:
        held: (2n - 1,) what the joints are commanded at that moment [rad]; the measured angles when None.
    """
    hold = replace(run, command=command, wheels=np.zeros(body.units), motion=None, patience=np.zeros(4))
    if not command.run:
        phase = "stopped" if run.status.phase in ("moving", "settling") else run.status.phase
        reason = "stopped by command" if phase != run.status.phase else run.status.reason
        return replace(hold, status=replace(run.status, number=command.number, phase=phase, reason=reason))
    shape = held_shape(angles, held, config)
    try:
        motion = plan_motion(shape, command, body.half_length, shift=config.trailing == "shift")
    except ConfigError as error:
        return replace(hold, status=RecoveryStatus(command.number, "refused", str(error)))
    duration = config.duration if command.duration is None else command.duration
    segment = slice(2 * command.first_unit, 2 * command.last_unit + 1)
    return RecoveryRun(
        command,
        RecoveryStatus(command.number, "moving"),
        shape,
        np.zeros(body.units),
        motion,
        config.settings(2 * (command.last_unit - command.first_unit) + 1, body.half_length),
        max(duration, motion.shortest_duration(config.max_control_speed, config.max_joint_rate)),
        sag=_from_start(angles[segment], motion, body) if (shape != angles).any() else np.zeros(6),
    )


def held_shape(angles: np.ndarray, held: np.ndarray | None, config: NullSpaceConfig) -> np.ndarray:
    """The angles (2n - 1,) that the pitch joints are told to hold, against the body's weight [rad].

    A drive carries weight by a command that leads its angle: from the measured angles the body would sink. Yaw joints
    carry no weight: what they press against is let go. At most half of `max_lead`, so that none looks blocked.
    """
    shape = angles.copy()
    if held is not None and config.feedback:
        lead = np.nan_to_num(held[::2] - angles[::2])
        shape[::2] += np.clip(lead, -0.5 * config.max_lead, 0.5 * config.max_lead)
    return shape


def _from_start(angles: np.ndarray, motion: RecoveryMotion, body: SnakeBody) -> np.ndarray:
    """(6,) the control point of a segment with `angles` (m,) against the start of its motion [m, rad]."""
    R, p = ChainKinematics(len(angles), body.half_length).control_pose(angles)
    return np.r_[p - motion.position[0], rotation_vector(R @ motion.rotation[0].T)]


def step_run(
    run: RecoveryRun, angles: np.ndarray, tip_margin: float, body: SnakeBody, config: NullSpaceConfig
) -> RecoveryRun:
    """One tick of a recovery that is moving or settling.

    Args:
        angles: (2n - 1,) measured angles [rad].
        tip_margin: distance of the centre of mass from the edge of the support polygon [m]; inf when not known.
    """
    motion, dt = run.motion, config.period
    if motion is None or run.status.phase not in ("moving", "settling"):
        return run
    if not np.isfinite(angles).all():
        return _wait_blind(run, angles, body, config)
    first, last = run.command.first_unit, run.command.last_unit
    segment = slice(2 * first, 2 * last + 1)
    limits = body.joint_limits[segment] - config.limit_reserve

    calm = _share(tip_margin, config.stop_margin, config.slow_margin)
    error_now = run.status.control_error
    size = np.linalg.norm(error_now[:3]) + body.half_length * np.linalg.norm(error_now[3:])
    pace = 1.0 - _share(float(size), config.slow_error, 2 * config.slow_error)
    time = min(run.time + calm * pace * dt / run.duration, 1.0)
    fraction, slope = minimum_jerk(time)
    fraction_rate = slope * (time - run.time) / dt

    begun, _ = minimum_jerk(run.elapsed / config.start_time)
    report, reference = np.zeros(kernel.REPORT), motion.reference(fraction, fraction_rate)
    # Not as a velocity to go at: the sag goes by itself with the load, the drives need not move for that.
    reference[:3] += (1.0 - begun) * run.sag[:3]
    reference[3:12] = (rotation_by((1.0 - begun) * run.sag[3:]) @ reference[3:12].reshape(3, 3)).ravel()
    settings = run.settings.copy()
    settings[kernel.MAX_NULL_RATE] *= begun if config.bounded else 1.0
    kinematic = angles if config.feedback else run.joints
    rates = recovery_tick(
        np.ascontiguousarray(kinematic[segment]),
        reference,
        motion.target,
        limits,
        settings,
        report,
    )
    if report[kernel.SINGULAR] > 0:
        reason = "the pose is singular (a straight segment is) and the law has no solution there: det(J Jᵀ) = 0"
        return _end(run, "stopped", reason, body)
    if not np.abs(rates).max() < _RUNAWAY:
        return _end(
            run, "stopped", f"the law asks for more than {_RUNAWAY:g} rad/s: its null-space term is unbounded", body
        )
    joints = run.joints.copy()
    joints[segment] += calm * rates * dt
    joints[2 * last + 1 :] = motion.trailing_angles(fraction)
    if config.bounded:
        reach = np.maximum(limits, np.abs(angles[segment]))
        joints[segment] = np.clip(joints[segment], -reach, reach)
    lead = joints - angles
    if config.feedback:
        joints[segment] = angles[segment] + np.clip(lead[segment], -config.max_lead, config.max_lead)
    moved = (joints - run.joints) / dt
    wheels = np.zeros(body.units)
    axle_rates(joints[2 * first :], moved[2 * first :], body.half_length, body.wheel_radius, wheels[first:])

    settling = run.settling + dt if time >= 1.0 else 0.0
    margin = float(np.min(body.joint_limits[2 * first :] - np.abs(angles[2 * first :])))
    status = replace(
        run.status,
        phase="settling" if time >= 1.0 else "moving",
        progress=fraction,
        control_error=report[:6].copy(),
        reference=reference[:12],
        distance=float(report[kernel.DISTANCE]),
        manipulability=float(report[kernel.MANIPULABILITY]),
        joint_margin=margin,
    )
    trouble = np.array(
        [
            np.linalg.norm(report[:3]) > config.stop_error or pace < 0.2,
            np.abs(lead).max() >= (0.98 if config.feedback else 3.0) * config.max_lead,
            calm == 0.0,
            False,
        ]
    )
    patience = np.where(trouble, run.patience + dt, 0.0)
    new = replace(
        run,
        status=status,
        joints=joints,
        wheels=wheels,
        time=time,
        elapsed=run.elapsed + dt,
        settling=settling,
        patience=patience,
    )
    return _judge(new, rates, report, lead, tip_margin, body, config)


def _judge(
    run: RecoveryRun,
    rates: np.ndarray,
    report: np.ndarray,
    lead: np.ndarray,
    tip_margin: float,
    body: SnakeBody,
    config: NullSpaceConfig,
) -> RecoveryRun:
    """Ends a run that is over, or that something has kept from going on for too long."""
    error = float(np.linalg.norm(report[:3]))
    if run.patience[_TIPPING] >= config.patience:
        return _end(run, "stopped", f"it would tip over: the margin is {1e3 * tip_margin:.0f} mm", body)
    if run.patience[_LAG] >= config.patience:
        worst = int(np.argmax(np.abs(lead)))
        reason = f"joint {joint_name(worst)} does not follow: it is blocked, overloaded or dead"
        return _end(run, "stopped", reason, body)
    if run.patience[_ERROR] >= config.patience:
        return _end(run, "stopped", _error_in_words(run, error, report, body, config), body)
    if run.status.phase != "settling":
        return run
    still = np.abs(rates).max() < 0.02 and run.settling > 0.2
    if not still and run.settling < config.settle_time:
        return run
    if error > config.done_error:
        return _end(run, "stopped", _error_in_words(run, error, report, body, config), body)
    gap = 1e3 * run.status.distance
    reason = f"the control point is {1e3 * error:.1f} mm from its place, the middle {gap:.0f} mm from the target"
    out_of_reach = run.motion.out_of_reach if run.motion is not None else 0.0
    if out_of_reach > 0.0:
        reason += f", which is at least {1e3 * out_of_reach:.0f} mm out of reach"
    return _end(run, "done", reason, body)


def _error_in_words(
    run: RecoveryRun, error: float, report: np.ndarray, body: SnakeBody, config: NullSpaceConfig
) -> str:
    reason = f"the control point is {1e3 * error:.0f} mm from its place"
    first = 2 * run.command.first_unit
    last = 2 * run.command.last_unit + 1
    near = np.flatnonzero(np.abs(run.joints[first:last]) > body.joint_limits[first:last] - config.limit_reserve - 0.02)
    if len(near):
        return f"{reason}: at the end of their range are {', '.join(joint_name(int(first + j)) for j in near)}"
    if report[kernel.MANIPULABILITY] < config.damped_below * body.half_length**3:
        return f"{reason}: the pose is nearly singular"
    return reason


def _wait_blind(run: RecoveryRun, angles: np.ndarray, body: SnakeBody, config: NullSpaceConfig) -> RecoveryRun:
    """Holds everything while an angle is missing, and gives up after a while."""
    patience = run.patience.copy()
    patience[_BLIND] += config.period
    held = replace(run, wheels=np.zeros(body.units), patience=patience)
    if patience[_BLIND] < config.patience:
        return held
    missing = ", ".join(joint_name(int(j)) for j in np.flatnonzero(~np.isfinite(angles)))
    return _end(held, "stopped", f"no angle is measured of {missing}", body)


def _end(run: RecoveryRun, phase: str, reason: str, body: SnakeBody) -> RecoveryRun:
    status = replace(run.status, phase=phase, reason=reason)
    return replace(run, status=status, wheels=np.zeros(body.units), motion=None)


def _share(value: float, low: float, high: float) -> float:
    """0 below `low`, 1 above `high`, linear between."""
    return float(np.clip((value - low) / max(high - low, 1e-12), 0.0, 1.0)) if np.isfinite(value) else float(value > 0)
