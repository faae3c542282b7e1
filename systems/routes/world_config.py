"""How a semantic map becomes a grid for routes."""

from dataclasses import dataclass, field

from ..config import quantity
from ..traversability import RiskMapConfig


@dataclass(kw_only=True)
class VoxelWorldConfig:
    """Voxels, what closes a cell, and how far the robot keeps from it."""

    # [m] Edge of a voxel (S0-h).
    voxel: float = quantity(0.1, unit="m", above=0)
    # [m] Distance that the reference point keeps from obstacles; 0: half the diagonal of the footprint, as always from
    # water and heat, whose edges are less sure.
    growth: float = quantity(0.0, unit="m", low=0)
    # [m] The same on steep ground, where the robot does not turn; 0: half the width of the footprint.
    steep_growth: float = quantity(0.0, unit="m", low=0)
    # [m] Flat ground this near to a slope or stair counts as steep there: landings are crossed straight.
    steep_reach: float = quantity(1.0, unit="m", low=0)
    # [m²] Steep ground that is smaller is debris.
    steep_area: float = quantity(0.3, unit="m²", low=0)
    # [m] Added to both.
    margin: float = quantity(0.05, unit="m", low=0)
    # [m] Distance from ground that was not seen.
    unknown_growth: float = quantity(0.2, unit="m", low=0)
    # [m] Gaps in the ground that was seen, up to this wide, are ground: a tracked robot bridges them.
    max_gap: float = quantity(0.3, unit="m", low=0)
    # [m] Unseen ground this near to where the robot stood is taken for ground: its sensors look over it.
    blind_radius: float = quantity(2.0, unit="m", low=0)
    # [m] Points up to this high over the ground are in the robot's way, or make the ground below them hot.
    robot_height: float = quantity(0.6, unit="m", above=0)
    # [m] Without an ability: points from this height on over a flat floor are obstacles, as in the paper.
    step: float = quantity(0.1, unit="m", above=0)
    # [rad] Ground from this slope on is steep.
    steep: float = quantity(0.15, unit="rad", above=0)
    # [m²] Ground from this roughness on is rough.
    rough: float = quantity(0.0003, unit="m²", above=0)
    # [µSv/h] Dose rate from which on ground must not be entered.
    max_dose_rate: float = quantity(1000.0, unit="µSv/h", above=0)
    # [-] What the highest risk that is passable adds to the cost of a metre, and the highest dose rate.
    risk_weight: float = quantity(2.0, low=0)
    dose_weight: float = quantity(4.0, low=0)
    # [-] Cost of a metre on ground that was not seen itself.
    unseen_cost: float = quantity(1.5, low=1)
    # [s] How often the map is looked at.
    period: float = quantity(1.0, unit="s", above=0)
    risk: RiskMapConfig = field(default_factory=RiskMapConfig)
