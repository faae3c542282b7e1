"""Features of the ground ahead, as a system."""

import numpy as np
from open3d.t.geometry import PointCloud
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, LeafSystem

from ..config import check_config
from ..ports import eval_typed, weak_method
from .features import describe_terrain
from .terrain_config import TerrainConfig


class TerrainFeatures(LeafSystem):
    """
    .. pydrake_system::

        name: TerrainFeatures
        input_ports:
        - cloud_H
        output_ports:
        - features

    Describes the ground in rectangles ahead of the robot (row S3-a, Eq. 1 to 6), see `describe_terrain`. It has no
    state: the features are computed when they are asked for.

    - `cloud_H` (`open3d.t.geometry.PointCloud`): points in the heading frame, whose origin is on the ground below the
      robot, z up and x ahead. Points that are not finite are left out.
    - `features` (`TerrainFeatureTable`): of every rectangle. Where nothing was seen they are NaN and the coverage is 0.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PortError: the input is not connected or of another type.
    """

    def __init__(self, config: TerrainConfig | None = None):
        super().__init__()
        self._config = config or TerrainConfig()
        check_config(self._config, where="terrain")
        self.DeclareAbstractInputPort("cloud_H", AbstractValue.Make(object()))
        self.DeclareAbstractOutputPort(
            "features", lambda: AbstractValue.Make(object()), weak_method(self._CalcFeatures)
        )

    def _CalcFeatures(self, context: Context, output: AbstractValue) -> None:
        cloud = eval_typed(self, context, "cloud_H", PointCloud)
        points = cloud.point.positions.numpy() if "positions" in cloud.point else np.zeros((0, 3))
        output.set_value(describe_terrain(points, self._config))
