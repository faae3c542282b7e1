"""When a recovery is over, and why, in words."""

from dataclasses import replace

import numpy as np

from . import null_space_kernels as kernel
from .null_space_config import NullSpaceConfig
from .recovery_motion import joint_name
from .recovery_state import RecoveryRun
from .snake_body import SnakeBody

_ERROR, _LAG, _TIPPING, _BLIND = range(4)
"""Troubles, by their places in `RecoveryRun.patience`."""


def judge_run(
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
        return end_run(run, "stopped", f"it would tip over: the margin is {1e3 * tip_margin:.0f} mm", body)
    if run.patience[_LAG] >= config.patience:
        worst = int(np.argmax(np.abs(lead)))
        reason = f"joint {joint_name(worst)} does not follow: it is blocked, overloaded or dead"
        return end_run(run, "stopped", reason, body)
    if run.patience[_ERROR] >= config.patience:
        return end_run(run, "stopped", _error_in_words(run, error, report, body, config), body)
    if run.status.phase != "settling":
        return run
    still = np.abs(rates).max() < 0.02 and run.settling > 0.2
    if not still and run.settling < config.settle_time:
        return run
    if error > config.done_error:
        return end_run(run, "stopped", _error_in_words(run, error, report, body, config), body)
    gap = 1e3 * run.status.distance
    reason = f"the control point is {1e3 * error:.1f} mm from its place, the middle {gap:.0f} mm from the target"
    out_of_reach = run.motion.out_of_reach if run.motion is not None else 0.0
    if out_of_reach > 0.0:
        reason += f", which is at least {1e3 * out_of_reach:.0f} mm out of reach"
    return end_run(run, "done", reason, body)


def _error_in_words(
    run: RecoveryRun, error: float, report: np.ndarray, body: SnakeBody, config: NullSpaceConfig
) -> str:
    reason = f"the control point is {1e3 * error:.0f} mm from its place"
    segment = run.command.joints
    near = np.flatnonzero(np.abs(run.joints[segment]) > body.joint_limits[segment] - config.limit_reserve - 0.02)
    if len(near):
        return f"{reason}: at the end of their range are {', '.join(joint_name(int(segment.start + j)) for j in near)}"
    if report[kernel.MANIPULABILITY] < config.damped_below * body.half_length**3:
        return f"{reason}: the pose is nearly singular"
    return reason


def wait_blind(run: RecoveryRun, angles: np.ndarray, body: SnakeBody, config: NullSpaceConfig) -> RecoveryRun:
    """Holds everything while an angle is missing, and gives up after a while."""
    patience = run.patience.copy()
    patience[_BLIND] += config.period
    held = replace(run, wheels=np.zeros(body.units), patience=patience)
    if patience[_BLIND] < config.patience:
        return held
    missing = ", ".join(joint_name(int(j)) for j in np.flatnonzero(~np.isfinite(angles)))
    return end_run(held, "stopped", f"no angle is measured of {missing}", body)


def end_run(run: RecoveryRun, phase: str, reason: str, body: SnakeBody) -> RecoveryRun:
    status = replace(run.status, phase=phase, reason=reason)
    return replace(run, status=status, wheels=np.zeros(body.units), motion=None)
