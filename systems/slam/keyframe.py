"""What scan matching hands on: keyframes, how far their poses can be trusted, and where they turned out to be."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

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
        X_PB: pose in the base of the keyframe before, P, as the registration of this one found it; None for the first.
            Unlike the difference of two X_MB it does not change when the map is corrected in between.
        covariance: (6, 6) of a small turn and shift in M's axes at the base, in the order roll, pitch, yaw, x, y, z
            [rad, m], against what it was registered to; None where nothing is known.
    """

    index: int
    time: float
    X_MB: RigidTransform
    X_OB: RigidTransform | None
    cloud_B: PointCloud
    health: float
    X_PB: RigidTransform | None = None
    covariance: np.ndarray | None = None

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


@dataclass(frozen=True, eq=False)
class KeyframePoses:
    """Where keyframes are after all that is known by now, as a pose graph finds it. Read-only.

    Attributes:
        version: rises whenever the pose of a keyframe that was given before has changed; 0 before the first change.
        poses: X_MB by `Keyframe.index`.
    """

    version: int = 0
    poses: dict[int, RigidTransform] = field(default_factory=dict)

    def __deepcopy__(self, memo: dict) -> "KeyframePoses":
        return self

    def of(self, keyframe: Keyframe) -> RigidTransform:
        """The pose of `keyframe`: its own where nothing else is known."""
        return self.poses.get(keyframe.index, keyframe.X_MB)

    def moved(self, keyframes: Iterable[Keyframe]) -> tuple[Keyframe, ...]:
        """`keyframes` at these poses."""
        return tuple(k if self.of(k) is k.X_MB else replace(k, X_MB=self.of(k)) for k in keyframes)


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
