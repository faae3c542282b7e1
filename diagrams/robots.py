"""The robots that a station can have, and what a scenario says about its robot."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from naraha.models.amphibious.urdf import AmphibiousShape
from naraha.models.crawler.urdf import CRAWLERS
from naraha.models.lux_robot.urdf import LuxRobotShape
from naraha.models.pioneer.urdf import PioneerShape
from naraha.systems.config import quantity
from naraha.systems.drive import CrawlerDriver, DifferentialDriver, TrackedDriver
from naraha.systems.errors import ConfigError, ScenarioError
from pydrake.math import RigidTransform, RollPitchYaw

from .seeds import sensor_seed

type Driver = CrawlerDriver | TrackedDriver | DifferentialDriver


@dataclass(frozen=True)
class RobotModel:
    """A robot that comes with the package.

    Attributes:
        url: of its URDF; `package://naraha/` is the models folder.
        driver: the type of its driver's configuration.
        base_height: of the base's origin over flat ground [m].
    """

    url: str
    driver: type[Driver]
    base_height: float


ROBOTS = {
    **{
        name: RobotModel(f"package://naraha/crawler/{name}.urdf", CrawlerDriver, shape.track_radius)
        for name, shape in CRAWLERS.items()
    },
    "pioneer": RobotModel("package://naraha/pioneer/pioneer.urdf", DifferentialDriver, PioneerShape().wheel_radius),
    "lux_robot": RobotModel(
        "package://naraha/lux_robot/lux_robot.urdf", DifferentialDriver, LuxRobotShape().wheel_radius
    ),
    "amphibious": RobotModel(
        "package://naraha/amphibious/amphibious.urdf", TrackedDriver, AmphibiousShape().track_radius
    ),
}
"""The robots by the name that `robot.model` of a scenario gives."""


@dataclass(kw_only=True)
class RobotConfig:
    """Which robot, where it starts, and its driver. What is left out is the model's own."""

    # One of `ROBOTS`.
    model: str = "crawler"
    # Start in the world: x, y and the height of the base's origin. Without a height the robot stands on z = 0.
    start_xyz: list[float] = quantity([0.0, 0.0], unit="m", min_length=2)
    # Heading at the start [deg].
    start_yaw_deg: float = quantity(0.0, unit="deg")
    # Driver of the model. In a scenario it needs no tag.
    driver: CrawlerDriver | TrackedDriver | DifferentialDriver | None = None

    def __post_init__(self) -> None:
        if self.model in ROBOTS:
            if len(self.start_xyz) == 2:
                self.start_xyz = [*self.start_xyz, ROBOTS[self.model].base_height]
            self.driver = self.driver or ROBOTS[self.model].driver()

    @staticmethod
    def fill_in(entries: dict[str, Any]) -> None:
        """Completes what a scenario says of its robot: the tag of the driver, and the height of the start."""
        model = entries.get("model", RobotConfig.model)
        if not isinstance(model, str) or model not in ROBOTS:
            return  # whoever builds the robot says what is wrong
        start = entries.setdefault("start_xyz", [0.0, 0.0])
        if isinstance(start, list) and len(start) == 2:
            entries["start_xyz"] = [*start, ROBOTS[model].base_height]
        driver = entries.get("driver") or {}
        if isinstance(driver, dict):
            entries["driver"] = {"_tag": f"!{ROBOTS[model].driver.__name__}", **driver}

    def known_model(self) -> RobotModel:
        """Raises `ScenarioError` when there is no such robot."""
        if self.model not in ROBOTS:
            raise ScenarioError("unknown robot", key="robot.model", value=self.model, valid=sorted(ROBOTS))
        return ROBOTS[self.model]

    def known_driver(self) -> Driver:
        """Raises `ConfigError` when the driver does not fit the model."""
        expected = self.known_model().driver
        if not isinstance(self.driver, expected):
            name, problem = type(self.driver).__name__, f"does not fit '{self.model}'"
            raise ConfigError(problem, key="robot.driver", value=name, valid=expected.__name__)
        return self.driver

    def X_WB(self) -> RigidTransform:
        """Pose of the base at the start. Raises `ConfigError` unless it has three coordinates."""
        self.known_model()
        if len(self.start_xyz) != 3:
            raise ConfigError("wrong length", key="robot.start_xyz", value=self.start_xyz, valid="x, y, z")
        return RigidTransform(RollPitchYaw(0, 0, np.deg2rad(self.start_yaw_deg)), np.array(self.start_xyz))


def seeded_driver(robot: RobotConfig, seed: int) -> Driver:
    """The robot's driver, whose encoders draw their scale errors from the run's seed."""
    driver = robot.known_driver()
    encoders = replace(driver.encoders, seed=sensor_seed(seed, f"encoders {driver.encoders.seed}"))
    return replace(driver, encoders=encoders)
