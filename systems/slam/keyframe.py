"""What scan matching hands on: keyframes, and how far its pose can be trusted."""

from dataclasses import dataclass

import numpy as np
from open3d.t.geometry import PointCloud
from pydrake.math import RigidTransform


@dataclass(frozen=True, eq=False)
class Keyframe:
    """A scan and where it was taken. Read-only: it is shared between ports, not copied.

    Attributes:
        index: `Scan.index` of the scan; -1, with an empty cloud, before there is one.
        time: the instant at which the pose is valid, the end of the scan [s].
        X_MB: pose of the robot base in the map.
        X_OB: pose in the odometry frame at the same instant, None without odometry.
        cloud_B: the scan, de-skewed to `time` and thinned to one mean point a voxel, with mean attributes.
        health: health of the registration that gave X_MB, 0 where it was placed by dead reckoning.
    """

    index: int
    time: float
    X_MB: RigidTransform
    X_OB: RigidTransform | None
    cloud_B: PointCloud
    health: float

    def __deepcopy__(self, memo: dict) -> "Keyframe":
        return self

    @property
    def p_BP(self) -> np.ndarray:
        """Points in B, (N, 3) float32 [m]."""
        if "positions" not in self.cloud_B.point:
            return np.zeros((0, 3), np.float32)
        return self.cloud_B.point.positions.numpy()


# Its cloud has no tensor at all: one that lived until the interpreter ends would make Open3D warn of a leak.
NO_KEYFRAME = Keyframe(-1, 0.0, RigidTransform(), None, PointCloud(), 0.0)


@dataclass(frozen=True)
class PoseHealth:
    """How far the pose of the scan matcher can be trusted.

    Attributes:
        valid: the last registration succeeded.
        health: its health in [0, 1], see `Registration.health`; 0 when it failed.
        reason: why it is not valid, or what else to know; "" when all is well.
        time: when the pose was last measured by a scan [s]; between scans it follows the odometry.
        scans_used: scans that were registered, or were too near the last keyframe to need it.
        scans_skipped: scans that had no usable points or could not be registered.
    """

    valid: bool
    health: float
    reason: str
    time: float
    scans_used: int
    scans_skipped: int

    def __deepcopy__(self, memo: dict) -> "PoseHealth":
        return self
