"""What a recovery knows between two ticks, and what it tells."""

from dataclasses import dataclass, field

import numpy as np

from .recovery_motion import RecoveryCommand, RecoveryMotion
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
        load: (m,) by how much the commands of the segment's joints led their angles then [rad], as its torques do.
        sagging: share of the sag that is still in the reference, 1 to 0; it goes as the load goes.
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
    load: np.ndarray = field(default_factory=lambda: np.zeros(0))
    sagging: float = 1.0

    def __deepcopy__(self, memo: dict) -> "RecoveryRun":
        return self


def idle_run(body: SnakeBody) -> RecoveryRun:
    """Before the first command."""
    return RecoveryRun(RecoveryCommand(), RecoveryStatus(), np.full(2 * body.units - 1, np.nan), np.zeros(body.units))
