"""How the localiser matches scans, and how far it trusts them."""

from dataclasses import dataclass, field

from ..config import quantity
from .evolution_strategy import EvolutionConfig
from .occupancy_grid import OccupancyConfig
from .uncertainty import PlanarOdometryAccuracy


@dataclass(kw_only=True)
class LocalizerConfig:
    """How a scan is matched to a map, and how far the result is trusted."""

    # `naraha`: evolution strategy, refinement, fusion with odometry. `paper`: evolution strategy alone.
    method: str = quantity("naraha", choices=("naraha", "paper"))
    # Whether the map grows; without, it is the one that was given.
    mapping: bool = False
    evolution: EvolutionConfig = field(default_factory=EvolutionConfig)
    occupancy: OccupancyConfig = field(default_factory=OccupancyConfig)
    odometry: PlanarOdometryAccuracy = field(default_factory=PlanarOdometryAccuracy)
    # [m], [deg] Deviation of the pose at the start.
    start_deviation: float = quantity(0.05, unit="m", above=0)
    start_deviation_deg: float = quantity(1.0, unit="deg", above=0)
    # [beams] As many of a scan are used, evenly; fewer returns than `min_beams` and the scan tells nothing.
    beams: int = quantity(240, unit="beams", low=10)
    min_beams: int = quantity(20, unit="beams", low=3)
    # [m] Farther returns are not used; the paper cut its laser to 15 m.
    max_range: float = quantity(30.0, unit="m", above=0)
    # [m] Reach of the likelihood field; beams that end farther from all walls have no say.
    reach: float = quantity(0.5, unit="m", above=0)
    # [m] Deviation of a beam's end: its own, and that of the map, which all beams on a patch of wall of this length
    # share.
    beam_deviation: float = quantity(0.02, unit="m", above=0)
    map_deviation: float = quantity(0.02, unit="m", above=0)
    patch_length: float = quantity(0.5, unit="m", above=0)
    # [m] Where a beam's weight has fallen to a quarter: people, and what is not in the map.
    robust_deviation: float = quantity(0.15, unit="m", above=0)
    # [deg] How far walls are from straight, in a map that was given and in one that is made on the way: by what lies
    # within, a bare wall tells nothing of where along it the robot is.
    normal_deviation_deg: float = quantity(5.0, unit="deg", low=0)
    mapped_normal_deviation_deg: float = quantity(8.0, unit="deg", low=0)
    # [-] By how much fitter than odometry's a pose has to be, to be believed when odometry says it cannot be.
    clearly_better: float = quantity(0.1, unit="-", low=0, high=1)
    # [m], [deg] After such a way or turn, scans err independently; before, they share the errors of the map.
    new_look: float = quantity(0.5, unit="m", above=0)
    new_look_deg: float = quantity(20.0, unit="deg", above=0)
    # [m], [deg] Least and largest deviation of the first generation.
    least_spread: float = quantity(0.03, unit="m", above=0)
    most_spread: float = quantity(0.3, unit="m", above=0)
    least_spread_deg: float = quantity(0.5, unit="deg", above=0)
    most_spread_deg: float = quantity(8.0, unit="deg", above=0)
    # [m], [deg] A keyframe is entered into the map after such a way or turn.
    keyframe_distance: float = quantity(0.5, unit="m", above=0)
    keyframe_angle_deg: float = quantity(17.0, unit="deg", above=0)
    # [m] Largest deviation of the position, and [-] least health for so many scans, with which the robot is not lost.
    lost_deviation: float = quantity(0.5, unit="m", above=0)
    min_health: float = quantity(0.3, unit="-", low=0, high=1)
    lost_scans: int = quantity(5, unit="scans", low=1)
