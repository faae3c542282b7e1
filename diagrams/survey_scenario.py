"""Everything that a survey can vary."""

from dataclasses import dataclass, field

from naraha.systems.changes import SurveyUpdateConfig
from naraha.systems.config import quantity
from naraha.systems.display import SemanticDisplayConfig
from naraha.systems.slam import OdometryConfig
from naraha.systems.tracking import KanayamaConfig, TourConfig

from .fusion import FusionConfig
from .recording import RecordingConfig
from .slam import SlamStages
from .station import StationConfig
from .survey_loop import LoopStages


@dataclass(kw_only=True)
class SurveyScenario(StationConfig, SlamStages):
    """Everything that a survey can vary."""

    description: str = ""
    # Seed of all noise, and of the world unless that has its own.
    seed: int = quantity(0, low=0)
    # The survey ends at the latest after this simulated time [s].
    duration: float = quantity(600.0, unit="s", above=0)
    # The survey fails when no waypoint is reached for this long [s]: the robot is stuck.
    patience: float = quantity(90.0, unit="s", above=0)
    # The survey fails when the robot is tilted more than this [rad].
    tip_over_angle: float = quantity(1.2, unit="rad", above=0)
    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    # What is made of the images and counts of the station's `head`; null, or no head, maps the LiDAR's points alone.
    fusion: FusionConfig | None = None
    # Folder of an earlier survey of the same place, which this one brings up to date; none when empty.
    earlier: str = ""
    update: SurveyUpdateConfig = field(default_factory=SurveyUpdateConfig)
    # The robot finds its own way instead of driving `tour`; needs `fusion` and `head`. Null drives the tour.
    loop: LoopStages | None = None
    tour: TourConfig = field(default_factory=TourConfig)
    tracking: KanayamaConfig = field(default_factory=KanayamaConfig)
    display: SemanticDisplayConfig = field(default_factory=SemanticDisplayConfig)
    # Null leaves no recording.html.
    recording: RecordingConfig | None = field(default_factory=RecordingConfig)
