"""Poses over time, gathered while a mission runs."""

from dataclasses import dataclass, field

import numpy as np
from pydrake.math import RigidTransform


@dataclass
class Trajectory:
    """Poses of one frame at rising times."""

    times: list[float] = field(default_factory=list)
    poses: list[RigidTransform] = field(default_factory=list)

    def append(self, time: float, pose: RigidTransform) -> None:
        """Adds a pose; a second one for the same instant is dropped."""
        if not self.times or time > self.times[-1]:
            self.times.append(time)
            self.poses.append(RigidTransform(pose))

    def matrices(self) -> np.ndarray:
        """(N, 4, 4)."""
        return np.array([pose.GetAsMatrix4() for pose in self.poses]).reshape(-1, 4, 4)

    def positions(self) -> np.ndarray:
        """(N, 3) [m]."""
        return np.array([pose.translation() for pose in self.poses]).reshape(-1, 3)

    def length(self) -> float:
        """Length of the path [m]."""
        return float(np.linalg.norm(np.diff(self.positions(), axis=0), axis=1).sum())

    def at(self, time: float) -> RigidTransform:
        """The pose nearest in time."""
        return self.poses[int(np.abs(np.array(self.times) - time).argmin())]
