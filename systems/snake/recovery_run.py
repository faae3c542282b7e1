"""A recovery from its start to its end, tick by tick: what `NullSpaceRecovery` does, without ports."""

from dataclasses import replace

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
    minimum_jerk,
    plan_motion,
    rotation_by,
    rotation_vector,
)
from .recovery_state import RecoveryRun, RecoveryStatus
from .recovery_verdict import end_run, judge_run, wait_blind
from .snake_body import SnakeBody

_RUNAWAY = 1e3
"""[rad/s] no joint can go that fast; a law without bounds may ask for it near a singular pose."""


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
    segment = command.joints
    load = (shape - angles)[segment]
    return RecoveryRun(
        command,
        RecoveryStatus(command.number, "moving"),
        shape,
        np.zeros(body.units),
        motion,
        config.settings(2 * (command.last_unit - command.first_unit) + 1, body.half_length),
        max(duration, motion.shortest_duration(config.max_control_speed, config.max_joint_rate)),
        sag=_from_start(angles[segment], motion, body) if load.any() else np.zeros(6),
        load=load,
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
        return wait_blind(run, angles, body, config)
    segment, trailing = run.command.joints, slice(2 * run.command.first_unit, None)
    limits = body.joint_limits[segment] - config.limit_reserve

    calm = _share(tip_margin, config.stop_margin, config.slow_margin)
    pace = _pace(run.status.control_error, body, config)
    time = min(run.time + calm * pace * dt / run.duration, 1.0)
    fraction, slope = minimum_jerk(time)
    begun, _ = minimum_jerk(run.elapsed / config.start_time)
    sagging = min(run.sagging, _load_left(run, angles), 1.0 - fraction)
    reference = _reference(run, motion, fraction, slope * (time - run.time) / dt, sagging)
    settings = run.settings.copy()
    settings[kernel.MAX_NULL_RATE] *= begun if config.bounded else 1.0
    report = np.zeros(kernel.REPORT)
    kinematic = angles if config.feedback else run.joints
    rates = recovery_tick(np.ascontiguousarray(kinematic[segment]), reference, motion.target, limits, settings, report)
    if report[kernel.SINGULAR] > 0:
        reason = "the pose is singular (a straight segment is) and the law has no solution there: det(J Jᵀ) = 0"
        return end_run(run, "stopped", reason, body)
    if not np.abs(rates).max() < _RUNAWAY:
        reason = f"the law asks for more than {_RUNAWAY:g} rad/s: its null-space term is unbounded"
        return end_run(run, "stopped", reason, body)
    joints, lead = _commanded(run, angles, calm * rates * dt, motion.trailing_angles(fraction), limits, config)
    moved = (joints - run.joints) / dt
    wheels = np.zeros(body.units)
    axle_rates(joints[trailing], moved[trailing], body.half_length, body.wheel_radius, wheels[run.command.first_unit :])

    status = replace(
        run.status,
        phase="settling" if time >= 1.0 else "moving",
        progress=fraction,
        control_error=report[:6].copy(),
        reference=reference[:12],
        distance=float(report[kernel.DISTANCE]),
        manipulability=float(report[kernel.MANIPULABILITY]),
        joint_margin=float(np.min(body.joint_limits[trailing] - np.abs(angles[trailing]))),
    )
    trouble = np.array(
        [
            np.linalg.norm(report[:3]) > config.stop_error or pace < 0.2,
            np.abs(lead).max() >= (0.98 if config.feedback else 3.0) * config.max_lead,
            calm == 0.0,
            False,
        ]
    )
    new = replace(
        run,
        status=status,
        joints=joints,
        wheels=wheels,
        time=time,
        elapsed=run.elapsed + dt,
        settling=run.settling + dt if time >= 1.0 else 0.0,
        sagging=sagging,
        patience=np.where(trouble, run.patience + dt, 0.0),
    )
    return judge_run(new, rates, report, lead, tip_margin, body, config)


def _pace(error: np.ndarray, body: SnakeBody, config: NullSpaceConfig) -> float:
    """How much of its speed the motion keeps, 0 to 1: it waits when the control point is off by `error` (6,)."""
    size = np.linalg.norm(error[:3]) + body.half_length * np.linalg.norm(error[3:])
    return 1.0 - _share(float(size), config.slow_error, 2 * config.slow_error)


def _load_left(run: RecoveryRun, angles: np.ndarray) -> float:
    """How much of the load with which the segment began its drives still carry, 0 to 1: they lead as it asks."""
    lead = (run.joints - angles)[run.command.joints]
    return float(np.clip(run.load @ lead / max(run.load @ run.load, 1e-12), 0.0, 1.0))


def _reference(run: RecoveryRun, motion: RecoveryMotion, fraction: float, rate: float, sagging: float) -> np.ndarray:
    """The motion's reference at a `fraction`, with the share `sagging` of the sag at the start.

    Not as a velocity to go at: the sag goes by itself with the load, the drives need not move for that.
    """
    reference = motion.reference(fraction, rate)
    reference[:3] += sagging * run.sag[:3]
    reference[3:12] = (rotation_by(sagging * run.sag[3:]) @ reference[3:12].reshape(3, 3)).ravel()
    return reference


def _commanded(
    run: RecoveryRun,
    angles: np.ndarray,
    step: np.ndarray,
    trailing: np.ndarray,
    limits: np.ndarray,
    config: NullSpaceConfig,
) -> tuple[np.ndarray, np.ndarray]:
    """Commands of all joints after a `step` of the segment [rad], and by how much they would lead the angles."""
    segment = run.command.joints
    joints = run.joints.copy()
    joints[segment] += step
    joints[segment.stop :] = trailing
    if config.bounded:
        reach = np.maximum(limits, np.abs(angles[segment]))
        joints[segment] = np.clip(joints[segment], -reach, reach)
    lead = joints - angles
    if config.feedback:
        joints[segment] = angles[segment] + np.clip(lead[segment], -config.max_lead, config.max_lead)
    return joints, lead


def _share(value: float, low: float, high: float) -> float:
    """0 below `low`, 1 above `high`, linear between."""
    return float(np.clip((value - low) / max(high - low, 1e-12), 0.0, 1.0)) if np.isfinite(value) else float(value > 0)
