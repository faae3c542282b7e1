"""What the metrics and products of a drive to a goal are made of, gathered while it runs."""

import numpy as np
from naraha.systems.slam import trajectory_error
from naraha.systems.tracking import planar_pose
from naraha.systems.traversability import Ability
from naraha.systems.traversability.histogram import REASONS, RiskHistogram
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, Diagram

from .mission import Ending
from .obstacle_distance import ObstacleDistance
from .station import station_world
from .trajectory import Trajectory
from .traverse_scenario import TraverseScenario
from .wiring import DiagramReader

# [m] A base that was this much higher than at its start has been on something.
_RAISED = 0.06
# [m] Nearer than this the robot has touched.
_TOUCHED = 0.002


class TraverseLog(DiagramReader):
    """What happened on the way, read from the running diagram at every step."""

    def __init__(self, scenario: TraverseScenario, ability: Ability, diagram: Diagram):
        super().__init__(diagram)
        self.scenario = scenario
        # The pose that steers: of the scan matching where there is one.
        self.believed = "odometry" if scenario.matching is None else "slam"
        self.trajectories = {name: Trajectory() for name in ("truth", "odometry", self.believed)}
        self.rows: list[list[float | str]] = []
        self.histograms: list[tuple[float, RiskHistogram, list[str]]] = []
        self._distance = ObstacleDistance(diagram, station_world(scenario, scenario.seed), ability.footprint)
        self._nearest, self._tilt, self._status = float("inf"), 0.0, ""
        self._tipped = False

    def step(self, context: Context) -> Ending | None:
        """Notes the state of now, and says whether the drive is over."""
        self.context, time = context, context.get_time()
        X_WB, X_OB = self.read("station.cheat.X_WB"), self.read("odometry.X_OB")
        self.trajectories["truth"].append(time, X_WB)
        self.trajectories["odometry"].append(time, X_OB)
        X_MB = X_OB
        if self.believed == "slam":
            X_MB = self.read("slam.X_MB")
            self.trajectories["slam"].append(time, X_MB)
        self._status = str(self.read("controller.status"))
        self._nearest = min(self._nearest, self._distance.nearest(context, X_WB))
        tilt = float(np.arccos(np.clip(X_WB.rotation().matrix()[2, 2], -1, 1)))
        self._tilt = max(self._tilt, tilt)
        self.rows.append([time, *_pose(X_WB), *_pose(X_MB), *self._command(), self._status])
        if not self.histograms or time >= self.histograms[-1][0] + 1.0 - 1e-6:
            histogram = self.read("histogram.histogram")
            self.histograms.append((time, histogram, [REASONS[reason] for reason in histogram.reason]))
        if tilt > self.scenario.tip_over_angle:
            self._tipped = True
            return Ending("failed", f"the robot tipped over at {time:.1f} s")
        if self._status == "arrived":
            return Ending("done", "the robot has arrived")
        if self._status == "no way":
            return Ending("failed", "no way leads to the goal")
        return None

    def judged(self, ending: Ending) -> Ending:
        """The ending, failed where the robot thinks that it has arrived and has not, or the time was over before."""
        if ending.status != "done":
            return ending
        if self._status != "arrived":
            return Ending("failed", f"{ending.reason}, and the robot is still {self._status}")
        if not self.reached:
            return Ending(
                "failed", f"the robot believes that it has arrived, {self.distance_to_goal:.2f} m from the goal"
            )
        return ending

    @property
    def distance_to_goal(self) -> float:
        """Of the true base, now [m]."""
        away = self.trajectories["truth"].poses[-1].translation()[:2] - self.scenario.goal[:2]
        return float(np.hypot(*away))

    @property
    def reached(self) -> bool:
        """Whether the robot says that it has arrived, and is right."""
        return self._status == "arrived" and self.distance_to_goal <= self.scenario.reached

    def status_line(self, context: Context) -> str:
        return f"{self._status}, {self.distance_to_goal:.1f} m to go"

    def metrics(self) -> dict[str, float | str | bool]:
        """How the drive went, by the truth."""
        truth = self.trajectories["truth"]
        heights = truth.positions()[:, 2]
        errors: dict[str, float | str | bool] = {}
        for name in dict.fromkeys(("odometry", self.believed)):
            found, prefix = self.trajectories[name], "odometry_" if name == "odometry" else ""
            mean, largest = trajectory_error(found.times, found.matrices(), truth.times, truth.matrices(), align="none")
            errors |= {f"{prefix}trajectory_error_mean_m": mean, f"{prefix}trajectory_error_max_m": largest}
        drive: dict[str, float | str | bool] = {
            "reached": self.reached,
            "time_s": truth.times[-1],
            "over_ramps": bool(heights.max() > heights[0] + _RAISED),
            "min_clearance_m": self._nearest,
            "collisions": int(self._nearest < _TOUCHED),
            "tipped": self._tipped,
            "max_tilt_rad": self._tilt,
            "path_length_m": truth.length(),
            "distance_to_goal_m": self.distance_to_goal,
            "final_status": self._status,
            "mean_speed_m_s": truth.length() / max(truth.times[-1], 1e-9),
        }
        return drive | errors

    def _command(self) -> list[float]:
        v, omega = self.read("tracking.twist_command")
        return [float(v), float(omega), float(self.read("controller.risk")[0])]


def _pose(X: RigidTransform) -> list[float]:
    x, y, heading = planar_pose(X)
    return [float(x), float(y), float(X.translation()[2]), float(heading)]
