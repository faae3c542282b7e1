"""Point clouds that share what they have and get more attributes."""

from collections.abc import Mapping

import numpy as np
import open3d as o3d
from open3d.t.geometry import PointCloud


def with_layers(cloud: PointCloud, layers: Mapping[str, np.ndarray]) -> PointCloud:
    """A cloud that shares the tensors of `cloud` and has `layers` (N,) or (N, K) besides, as float32."""
    grown = PointCloud()
    for name, tensor in cloud.point.items():
        grown.point[name] = tensor
    for name, values in layers.items():
        grown.point[name] = o3d.core.Tensor(np.ascontiguousarray(values.reshape(len(values), -1), np.float32))
    return grown
