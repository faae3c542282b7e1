"""How routes are looked for, told apart, smoothed and judged."""

from dataclasses import dataclass, field

from ..config import quantity


@dataclass(kw_only=True)
class SmoothingConfig:
    """How a way over cells becomes a curve."""

    # [m] Distance of the points of a route.
    spacing: float = quantity(0.1, unit="m", above=0)
    # [1/m] Largest curvature that is aimed at; a corner that no curve leads round stays, and is turned on the spot.
    max_curvature: float = quantity(2.5, unit="1/m", above=0)
    # [m] Clearance that is looked for; where there is less the route comes no nearer than the way over cells did.
    clearance: float = quantity(0.3, unit="m", low=0)
    # [-] Share by which a straight cut may cost more than the way over cells that it replaces.
    tolerance: float = quantity(0.02, low=0)
    # Rounds of smoothing at most, of 40 steps each.
    rounds: int = quantity(60, unit="rounds", low=0)


@dataclass(kw_only=True)
class RoutesConfig:
    """Which ways are offered."""

    # Routes that are offered at most.
    most: int = quantity(4, unit="routes", low=1, high=20)
    # [-] A route costs at most this many times what the best one does.
    max_stretch: float = quantity(3.0, low=1)
    # [m] Two routes are the same way unless one is somewhere farther from the other than this.
    separation: float = quantity(1.0, unit="m", above=0)
    # [-] How much a route that runs all along offered ones, nearer than `separation`, counts as costlier.
    overlap_penalty: float = quantity(1.0, low=0)
    # [m], [-] Cells with less clearance cost more, up to this factor beside an obstacle.
    comfort: float = quantity(0.4, unit="m", low=0)
    comfort_factor: float = quantity(2.0, low=1)
    # [rad] Steepest ground along a step of the way, and across it: a stair is climbed straight.
    max_pitch: float = quantity(0.75, unit="rad", above=0)
    max_roll: float = quantity(0.35, unit="rad", above=0)
    # [m] Heights are averaged over about this length before slopes are taken.
    slope_length: float = quantity(0.5, unit="m", above=0)
    # Classes that the exact search goes through at most, and states that it looks at.
    classes: int = quantity(16, unit="classes", low=1, high=64)
    states: int = quantity(1_000_000, unit="states", low=1000)
    # [m] How far around a route ground that was not seen makes it less sure.
    look: float = quantity(0.5, unit="m", low=0)
    # [m/s], [rad/s] Speeds that the time is computed with.
    speed: float = quantity(0.3, unit="m/s", above=0)
    turn_rate: float = quantity(0.5, unit="rad/s", above=0)
    # [-] On slopes the speed is divided by 1 + this · tan²: two at the 35° of a stair.
    slope_slowdown: float = quantity(2.0, low=0)
    smoothing: SmoothingConfig = field(default_factory=SmoothingConfig)
