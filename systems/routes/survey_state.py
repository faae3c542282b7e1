"""What the survey loop knows: how it decides, where it is, what it decides by."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..config import quantity
from .frontiers import FrontierConfig, View
from .route import Route
from .route_grid import RouteGrid
from .voxels import Voxels

PHASES = ("wait", "choose", "learn", "offer", "drive", "back", "face", "look", "held", "done")
OPERATORS = ("auto", "prompt")


@dataclass(kw_only=True)
class SurveyLoopConfig:
    """How a survey without a tour decides where to look, and when it goes home."""

    # "auto" takes the cheapest route, "prompt" waits for the operator's `choice`.
    operator: str = quantity("auto", choices=OPERATORS)
    # [s] From this simulated time on the robot goes home.
    time_budget: float = quantity(480.0, unit="s", above=0)
    # [s] How long a route is learnt at most, and how long at least: the learner must have noticed the goal.
    learn_time: float = quantity(10.0, unit="s", above=0)
    settle_time: float = quantity(0.5, unit="s", low=0)
    # [s] A leg ends without arrival after this multiple of its predicted time, and when the path was left this long.
    slow: float = quantity(3.0, low=1)
    off_time: float = quantity(3.0, unit="s", low=0)
    # [s] A robot that has not moved for this long under way is caught on something: it goes back the way it came.
    stall_time: float = quantity(8.0, unit="s", above=0)
    # [m/s], [s] How fast and how long.
    back_speed: float = quantity(0.15, unit="m/s", low=0)
    back_time: float = quantity(3.0, unit="s", low=0)
    # Goals without a way that are tried one after the other before the robot goes home, and tries at the way home.
    most_failures: int = quantity(8, low=0)
    # [-] A goal of which only this share of what it promised is still to be seen is let go on the way.
    keep_gain: float = quantity(0.3, low=0, high=1)
    # [s] How long the robot waits for a map in which there is free ground around it.
    patience: float = quantity(30.0, unit="s", above=0)
    # [m] The robot may stand this far from a free cell: routes begin at the nearest.
    snap: float = quantity(0.5, unit="m", above=0)
    # [rad] Largest error of the heading at a look. [1/s], [rad/s] Gain and yaw rates of turning to it.
    face_tolerance: float = quantity(0.08, unit="rad", above=0)
    turn_gain: float = quantity(1.5, unit="1/s", above=0)
    turn_rate: float = quantity(0.8, unit="rad/s", above=0)
    min_turn_rate: float = quantity(0.15, unit="rad/s", low=0)
    # [m], [rad] A rise of the route this steep within this distance ahead calls for the preset `climb`.
    climb_ahead: float = quantity(0.6, unit="m", above=0)
    climb_slope: float = quantity(0.25, unit="rad", above=0)
    # [s] Period of the decisions.
    period: float = quantity(0.2, unit="s", above=0)
    frontiers: FrontierConfig = field(default_factory=FrontierConfig)


@dataclass(frozen=True, eq=False)
class LoopState:
    """Where the survey is; read-only.

    Attributes:
        phase: of `PHASES`. since: when it began [s].
        home: x, y of the start [m]; None before the first map. way_home: the free place beside it that is driven to.
        view: the look that is the goal; None without. gain: what it promised [bit m²]. homeward: whether home is.
        judged: the `interest` by which the goal was last judged.
        start: (3,) pose at which routes to the goal begin, NaN without goal [m, m, rad].
        views: looks that took their time, and goals that were given up. looks: all that were taken. short: the last
            one that had its answers early.
        offers: routes that the operator may choose from. chosen: which one is driven, -1 for none yet.
        moved: when and where (x, y, heading) the robot last moved under way [s; m, m, rad].
        legs: legs driven to their end. offered: routes offered so far. closed: legs ended by a newer map.
        passed: goals let go because they were seen on the way. held: how often somebody else took over.
        stalled: how often the robot was caught on something.
        failures: goals without a way, one after the other. returned: whether the robot is back home.
        reason: why the survey goes home or is done.
    """

    phase: str = "wait"
    since: float = 0.0
    home: tuple[float, float] | None = None
    way_home: tuple[float, float] = (np.nan, np.nan)
    view: View | None = None
    gain: float = 0.0
    judged: np.ndarray | None = None
    homeward: bool = False
    start: tuple[float, float, float] = (np.nan, np.nan, np.nan)
    views: tuple[View, ...] = ()
    looks: int = 0
    short: View | None = None
    offers: tuple[Route, ...] = ()
    chosen: int = -1
    moved: tuple[float, float, float, float] = (0.0, np.nan, np.nan, np.nan)
    legs: int = 0
    stalled: int = 0
    offered: int = 0
    closed: int = 0
    passed: int = 0
    held: int = 0
    failures: int = 0
    returned: bool = False
    reason: str = ""

    def __deepcopy__(self, memo: dict) -> "LoopState":
        return self

    @property
    def route(self) -> Route:
        """The route that is driven now, one without points otherwise."""
        return self.offers[self.chosen] if self.phase == "drive" else Route()

    @property
    def goal(self) -> tuple[float, float]:
        """x, y [m], NaN without."""
        if self.homeward:
            return self.way_home
        return (np.nan, np.nan) if self.view is None else (self.view.x, self.view.y)


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What the loop decides by.

    Attributes:
        pose: (3,) x, y, heading in M. grid, voxels, interest: of the newest map, as from `VoxelWorld`.
        learning: status of the learner. routes: computes the routes from `start` to `goal` of the state.
        driving: status of the path follower. choice: index of the operator's choice, negative as long as there is none.
        mode: who drives, "autonomous" when it is the loop.
    """

    pose: np.ndarray
    grid: RouteGrid
    voxels: Voxels
    learning: str
    routes: Callable[[], tuple[Route, ...]]
    driving: str
    choice: int = -1
    interest: np.ndarray | None = None
    mode: str = "autonomous"
