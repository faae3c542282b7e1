"""What the fuzzy VFH controller knows, sees and commands."""

from dataclasses import dataclass, field

import numpy as np

from ..config import quantity
from .histogram import RiskHistogram
from .wavefront import CostField, WavefrontConfig

# "paper": the candidate nearest to the goal and nothing else (S3-c); "full": memory, recovery and "no way".
PRESETS = ("full", "paper")
DRIVING, TURNING, BACKING, LOOKING = "driving", "turning", "backing", "looking"
ARRIVED, NO_WAY = "arrived", "no way"
NOWHERE = (np.nan, np.nan)


@dataclass(kw_only=True)
class VfhConfig:
    """How a direction is chosen and what is done when there is none."""

    preset: str = quantity("full", choices=PRESETS)
    # [s] Period of the decisions.
    period: float = quantity(0.1, unit="s", above=0)
    # [s] Stands still for so long at first: the IMU finds the vertical, the LiDAR shows what is ahead.
    start_time: float = quantity(0.0, unit="s", low=0)
    # [m] From the goal at which the robot has arrived; it stays so up to twice that.
    tolerance: float = quantity(0.15, unit="m", above=0)
    # [-] Reference speed v_r as a share of the robot's fastest; the rest comes from K_x x_e.
    reference_share: float = quantity(0.3, unit="-", above=0, high=1)
    # [-] Least share of v_r that risk leaves, as `min_gain_share` of the tracking.
    min_speed_share: float = quantity(0.1, unit="-", above=0, high=1)
    # [m/s²] Deceleration towards the goal.
    deceleration: float = quantity(0.3, unit="m/s²", above=0)
    # [-] Weight of the angle to the direction driven so far, against that to the direction wanted: keeps it from
    # changing between two directions that are as good.
    inertia: float = quantity(0.3, unit="-", low=0)
    # [deg] Turns on the spot start when the direction wanted is farther to the side, and end when it is nearer.
    turn_start_deg: float = quantity(60.0, unit="deg", above=0, high=180)
    turn_end_deg: float = quantity(15.0, unit="deg", above=0, high=90)
    # [deg] How far from the way over remembered ground the histogram may lead.
    detour_deg: float = quantity(50.0, unit="deg", low=0, high=180)
    # [1/s], [rad/s] Gain and least rate of turns on the spot; below the least, skidding tracks stand still.
    turn_gain: float = quantity(1.5, unit="1/s", above=0)
    min_turn_rate: float = quantity(0.2, unit="rad/s", above=0)
    # [m/s], [m] Speed backwards, and how far after the robot was stuck.
    back_speed: float = quantity(0.15, unit="m/s", above=0)
    back_distance: float = quantity(0.3, unit="m", above=0)
    # [m] How far the robot backs up at most until it has room to turn.
    longest_back: float = quantity(1.5, unit="m", above=0)
    # [m/rad] Where turning on the spot slides the robot farther than this, it backs up first, as far as that.
    longest_slide: float = quantity(0.1, unit="m/rad", low=0)
    # [s], [m], [deg] Stuck is who was told to move for so long and moved and turned no more than that.
    stuck_time: float = quantity(4.0, unit="s", above=0)
    stuck_distance: float = quantity(0.08, unit="m", above=0)
    stuck_turn_deg: float = quantity(6.0, unit="deg", above=0)
    # [deg], [s] Caught at an edge that the LiDAR does not show is who, driving, turned so much farther than it was told
    # to, or the other way; what was longer ago counts less and less.
    caught_turn_deg: float = quantity(20.0, unit="deg", above=0)
    caught_time: float = quantity(1.0, unit="s", above=0)
    # [s] How long the histogram may refuse what is remembered as passable, before it is marked impassable.
    patience: float = quantity(1.5, unit="s", above=0)
    # [m], [-] From here on what is impassable beside the way or ahead raises the risk, up to this share of the limit
    # where it would be touched.
    beside: float = quantity(0.5, unit="m", above=0)
    beside_share: float = quantity(0.6, unit="-", low=0, high=1)
    # [m] Length of the sub-goal over remembered ground, where the histogram's rectangles are too long.
    near: float = quantity(0.7, unit="m", above=0)
    # Updates of the memory in a row that must say that there is no way, or that there is one again.
    confirmations: int = quantity(4, unit="updates", low=1)
    wavefront: WavefrontConfig = field(default_factory=WavefrontConfig)


@dataclass(frozen=True)
class Sight:
    """What a decision is based on.

    Attributes:
        time: [s]. pose: (3,) x, y, heading in M [m, m, rad]. goal: (2,) in M [m].
        histogram: of the ground ahead.
        field: cost to the goal over remembered ground, None without a memory.
        index: of the memory; counts decisions without one.
        way: (2,) point in M to steer for, None when there is no way.
        obstacles: (n, 2) in the robot's heading frame [m], impassable cells within reach of its corners.
        yaw_rate: that the drive is told to turn at [rad/s], NaN where it is not known.
        downhill: (2,) in the robot's heading frame, as long as the sine of its tilt [-].
    """

    time: float
    pose: np.ndarray
    goal: np.ndarray
    histogram: RiskHistogram
    field: CostField | None
    index: int
    way: np.ndarray | None
    obstacles: np.ndarray
    yaw_rate: float = np.nan
    downhill: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class VfhState:
    """What the controller remembers from decision to decision.

    Attributes:
        status: what it is doing.
        goal: (x, y) in M that the rest is about [m].
        aim: direction in M that it drives in [rad], NaN when it does not.
        side: +1 while it turns to the left, -1 to the right, 0 when it does not turn.
        turned: how far it turned since it last got away from `spot` [rad].
        spot: (x, y) in M where it began to turn [m].
        held: (x, y) in M that it keeps to after it turned to and fro on one spot [m], NaN when it does not.
        heading: at the last decision [rad].
        astray: how far it turned of late without being told to, while it drove [rad].
        anchor: (x, y, heading, time) from where it is watched whether the robot moves.
        back_from: (x, y, time) where it began to back up. back_to: how far it is to do so [m].
        track: (x, y, heading) that it drove through since its last turn on the spot, without what it backed up over.
        on_track: it backs up on that, and not straight.
        backed: it has backed up for room already since it last drove. looked_back: and to see what is near, too.
        refused_since: when the histogram began to refuse what is remembered as passable [s], NaN when it does not.
        index: of the memory at the last decision.
        without, again: updates of the memory in a row that said that there is no way, and that there is one.
        marks: (x, y, radius, kind) taken for obstacles, see `spread_costs`.
    """

    status: str = DRIVING
    goal: tuple[float, float] = (np.nan, np.nan)
    aim: float = np.nan
    side: float = 0.0
    turned: float = 0.0
    spot: tuple[float, float] = (np.nan, np.nan)
    held: tuple[float, float] = (np.nan, np.nan)
    heading: float = np.nan
    astray: float = 0.0
    anchor: tuple[float, float, float, float] = (np.nan, np.nan, np.nan, np.nan)
    back_from: tuple[float, float, float] = (np.nan, np.nan, np.nan)
    back_to: float = 0.0
    track: tuple[tuple[float, float, float], ...] = ()
    on_track: bool = False
    backed: bool = False
    looked_back: bool = False
    refused_since: float = np.nan
    index: int = -1
    without: int = 0
    again: int = 0
    marks: tuple[tuple[float, float, float, float], ...] = ()


@dataclass(frozen=True)
class Command:
    """What the robot is to do until the next decision.

    Attributes:
        subgoal: (x, y, heading) in M [m, m, rad], None for the robot's own pose.
        v_r, omega_r: reference speed [m/s] and yaw rate [rad/s].
        risk: r of the ground that was chosen, 0 without any.
    """

    subgoal: tuple[float, float, float] | None = None
    v_r: float = 0.0
    omega_r: float = 0.0
    risk: float = 0.0


Decision = tuple[VfhState, Command]
