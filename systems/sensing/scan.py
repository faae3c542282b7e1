"""One LiDAR scan as it travels between systems."""

from dataclasses import dataclass

import numpy as np
from open3d.t.geometry import PointCloud


@dataclass(frozen=True, eq=False)
class Scan:
    """One scan in the sensor frame S. Read-only: it is shared between ports, not copied.

    Every point is expressed in S at the instant at which it was measured, as a real LiDAR reports it. A pose that is
    estimated from a scan is the pose of S at `end_time`.

    Attributes:
        cloud_S: points, (N, 3) float32 [m], with named attributes. Simulated scans have
            `intensity` (N, 1) float32 in [0, 1] (reflectivity after range correction),
            `time` (N, 1) float32 [s] since `start_time`, `ring` (N, 1) uint8 and `column` (N, 1) uint16;
            recorded scans have what the file has.
        start_time, end_time: [s], of the first and of the last ray. Equal when the scan was de-skewed.
        index: number of the scan since the start.
    """

    cloud_S: PointCloud
    start_time: float
    end_time: float
    index: int

    @property
    def p_SP(self) -> np.ndarray:
        """Points in S, (N, 3) float32 [m]."""
        return self.cloud_S.point.positions.numpy()

    def attribute(self, name: str) -> np.ndarray | None:
        """Attribute `name` as an (N,) array, or None where the scan does not have it."""
        if name not in self.cloud_S.point:
            return None
        values = self.cloud_S.point[name].numpy()
        return values[:, 0] if values.ndim == 2 else values
