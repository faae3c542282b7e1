"""What null-space recovery can be set to, and the paper's own setting."""

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from ..config import check_config, quantity
from ..errors import ConfigError
from . import null_space_kernels as kernel


@dataclass(kw_only=True)
class NullSpaceConfig:
    """Gains, weights and bounds of `NullSpaceRecovery` (rows S1-a and S1-b); the paper gives no numbers for them."""

    # Time between two ticks.
    period: float = quantity(0.01, unit="s", above=0.0)
    # Time of the motion of the control point; longer where a joint or the control point would be too fast.
    duration: float = quantity(4.0, unit="s", above=0.0)
    # At its beginning, time in which the null-space term comes in.
    start_time: float = quantity(0.4, unit="s", above=0.0)
    # Afterwards, the longest time for the rest of the way to the target.
    settle_time: float = quantity(2.0, unit="s", low=0.0)
    # Largest speed of the control point.
    max_control_speed: float = quantity(0.15, unit="m/s", above=0.0)

    # K of row S1-a, for position and attitude.
    k_position: float = quantity(4.0, unit="1/s", low=0.0)
    k_rotation: float = quantity(4.0, unit="1/s", low=0.0)
    # α of row S1-a.
    alpha: float = quantity(-8.0, unit="1/s", high=0.0)
    # Weights a_t, a_s and a_j of row S1-b. With V_singular = 1/det a weight of 1 drowns the target: for five units
    # 1/det is between 1e2 and 1e6, d² about 1e-2. With -log det a weight of 1e-3 keeps the control point within 5 mm of
    # its way also when a target straight ahead leaves a straight segment straight; 2e-4 and 0 do not.
    target_weight: float = quantity(1.0, low=0.0)
    singular_weight: float = quantity(1e-3, low=0.0)
    # V_joint is a cube of radians, at most 5e-3 within the margin: with a weight of 1 nobody feels it.
    joint_weight: float = quantity(100.0, low=0.0)
    # What of the determinant is the cost: "log" is -log det(JJᵀ), "inverse" the paper's 1/det(JJᵀ).
    singularity: str = quantity("log", choices=("log", "inverse"))
    # θ_lim of row S1-b is that much inside the range.
    joint_margin: float = quantity(np.deg2rad(10.0), unit="rad", low=0.0)

    # Largest damping of the pseudo-inverse near a singular pose; 0 for none.
    damping: float = quantity(0.02, low=0.0)
    # It begins where √det(JJᵀ) falls below this times the half length cubed (smallest singular value about 0.01).
    damped_below: float = quantity(1.0, low=0.0)
    # Whether joints are kept within their ranges and rates by construction, with the two below.
    bounded: bool = True
    # Largest norm of α η.
    max_null_rate: float = quantity(2.0, unit="rad/s", above=0.0)
    # Largest rate of a joint.
    max_joint_rate: float = quantity(1.2, unit="rad/s", above=0.0)
    # That much of the mechanical range is not used.
    limit_reserve: float = quantity(np.deg2rad(2.0), unit="rad", low=0.0)
    # How fast a joint may come towards the end of its range.
    limit_gain: float = quantity(5.0, unit="1/s", above=0.0)

    # Whether the kinematics is that of the measured angles; of the commanded ones otherwise.
    feedback: bool = True
    # How far a command may lead the measured angle: what the drive needs for its largest torque.
    max_lead: float = quantity(0.06, unit="rad", above=0.0)
    # What the joints behind the control point do: "shift" (row S1-c), or "hold" their angles.
    trailing: str = quantity("shift", choices=("shift", "hold"))

    # Error of the control point at which the motion waits for it, and at which it is given up after `patience`.
    slow_error: float = quantity(0.02, unit="m", above=0.0)
    stop_error: float = quantity(0.05, unit="m", above=0.0)
    # Error of the control point with which the recovery counts as done.
    done_error: float = quantity(0.005, unit="m", above=0.0)
    # Tip-over margin below which the motion slows down, and at which it waits.
    slow_margin: float = quantity(0.03, unit="m")
    stop_margin: float = quantity(0.01, unit="m")
    # How long something may last that stops the recovery: an error, waiting, a joint that does not follow.
    patience: float = quantity(1.0, unit="s", low=0.0)

    def settings(self, joints: int, half_length: float) -> NDArray[np.float64]:
        """The `settings` of `recovery_tick` for a segment of `joints` joints."""
        check_config(self, key="null_space")
        s = np.zeros(kernel.SETTINGS)
        s[kernel.HALF_LENGTH], s[kernel.MIDDLE] = half_length, (joints - 1) // 2
        s[kernel.K_POSITION], s[kernel.K_ROTATION], s[kernel.ALPHA] = self.k_position, self.k_rotation, self.alpha
        s[kernel.TARGET_WEIGHT], s[kernel.SINGULAR_WEIGHT] = self.target_weight, self.singular_weight
        s[kernel.JOINT_WEIGHT], s[kernel.JOINT_MARGIN] = self.joint_weight, self.joint_margin
        s[kernel.LOG_SINGULAR] = self.singularity == "log"
        s[kernel.DAMPING], s[kernel.DAMPED_BELOW] = self.damping, self.damped_below
        s[kernel.BOUNDED] = self.bounded
        s[kernel.MAX_NULL_RATE] = self.max_null_rate if self.bounded else np.inf
        s[kernel.MAX_RATE], s[kernel.LIMIT_GAIN] = self.max_joint_rate, self.limit_gain
        return s


PRESETS: dict[str, dict[str, object]] = {
    "naraha": {},
    # Rows S1-a and S1-b as published: all weights 1 and no bounds, where the paper gives no numbers.
    "paper": {
        "singularity": "inverse",
        "singular_weight": 1.0,
        "joint_weight": 1.0,
        "alpha": -1.0,
        "joint_margin": 0.0,
        "damping": 0.0,
        "bounded": False,
        "feedback": False,
    },
}
"""What the presets change of the default."""


def preset(name: str, **changes: object) -> NullSpaceConfig:
    """The configuration `name` of `PRESETS` with `changes`.

    Raises:
        ConfigError: there is no such preset or field, or a value is out of range.
    """
    if name not in PRESETS:
        raise ConfigError("unknown preset", key="preset", value=name, valid=sorted(PRESETS))
    known = {field.name for field in fields(NullSpaceConfig)}
    if unknown := sorted(set(changes) - known):
        raise ConfigError("unknown key", key=unknown[0], valid=sorted(known))
    config = replace(NullSpaceConfig(), **(PRESETS[name] | changes))  # type: ignore[arg-type]
    check_config(config, key="null_space")
    return config
