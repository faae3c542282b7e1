"""What a drive to a goal can vary."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from naraha.systems.clouds import LocalCloudConfig
from naraha.systems.config import quantity
from naraha.systems.errors import ScenarioError
from naraha.systems.slam import OdometryConfig
from naraha.systems.tracking import KanayamaConfig
from naraha.systems.traversability import RiskMemoryConfig, TerrainConfig, VfhConfig

from .recording import RecordingConfig
from .robot_files import robot_file
from .scenario import load_scenario
from .slam import SlamStages
from .station import StationConfig


@dataclass(kw_only=True)
class TraverseScenario(StationConfig):
    """Everything that a drive to a goal can vary."""

    description: str = ""
    # Seed of all noise, and of the world unless that has its own.
    seed: int = quantity(0, low=0)
    # Where to drive, in W, which the odometry knows from its start [m].
    goal: list[float] = quantity([0.0, 0.0], unit="m", min_length=2)
    # What the robot can drive over: the name of a file beside its model, or a YAML file.
    ability: str = "ability"
    # The drive ends at the latest after this simulated time [s].
    duration: float = quantity(120.0, unit="s", above=0)
    # [m] The robot has reached the goal when its base is truly this near to it.
    reached: float = quantity(0.5, unit="m", above=0)
    # The drive fails when the robot is tilted more than this [rad].
    tip_over_angle: float = quantity(1.2, unit="rad", above=0)
    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    # Scan matching that corrects the pose; null drives on odometry alone. A tilting LiDAR shows too little at a time.
    matching: SlamStages | None = None
    local_cloud: LocalCloudConfig = field(default_factory=LocalCloudConfig)
    terrain: TerrainConfig = field(default_factory=TerrainConfig)
    # What is remembered of the ground; null drives by the histogram alone, as the paper does.
    memory: RiskMemoryConfig | None = field(default_factory=RiskMemoryConfig)
    vfh: VfhConfig = field(default_factory=lambda: VfhConfig(start_time=1.0))
    # With a `risk_limit` of 0 or more, K_x falls with the risk (Eq. 9); null keeps it fixed.
    tracking: KanayamaConfig = field(default_factory=KanayamaConfig)
    # Whether speeds and `risk_limit` of the tracking are those of the ability.
    tracking_from_ability: bool = True
    # Null leaves no recording.html.
    recording: RecordingConfig | None = field(default_factory=RecordingConfig)


def load_traverse(
    name: str, robot: str | None, settings: Sequence[str] = (), seed: int | None = None
) -> TraverseScenario:
    """Reads a scenario for one of the robots, with what that robot brings along: its model, driver and sensors.

    Raises:
        ScenarioError, ConfigError: no such scenario or robot, or a value that cannot be used.
    """
    scenario = load_scenario(TraverseScenario, name, settings, seed, base=None if robot is None else robot_file(robot))
    robot_config = scenario.robot
    if len(robot_config.start_xyz) == 2:  # on the floor, whatever robot it is
        robot_config.start_xyz = [*robot_config.start_xyz, robot_config.known_model().base_height]
    if len(scenario.goal) != 2:
        raise ScenarioError("wrong length", where=name, key="goal", value=scenario.goal, valid="x, y")
    return scenario
