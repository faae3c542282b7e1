"""Polar histogram of risk, as a system."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, LeafSystem

from ..errors import PortError
from ..ports import eval_typed, weak_method
from .ability import Ability, check_ability
from .features import TerrainFeatureTable
from .histogram import make_histogram


class PolarRiskHistogram(LeafSystem):
    """
    .. pydrake_system::

        name: PolarRiskHistogram
        input_ports:
        - features
        - traversability
        output_ports:
        - histogram

    Risk of the ground by direction (row S3-c): r = 1/τ, and a large risk where a threshold of the robot's ability rules
    a rectangle out, with the reason, see `make_histogram`. It has no state.

    - `features` (`TerrainFeatureTable`): of K rectangles.
    - `traversability` (K): τ of each.
    - `histogram` (`RiskHistogram`).

    Args:
        ability: of the robot. rectangles: K.

    Raises:
        ConfigError: a limit of the ability cannot be used.
        PortError: an input is not connected, of another type, or of another number of rectangles.
    """

    def __init__(self, ability: Ability, rectangles: int = 9):
        super().__init__()
        check_ability(ability)
        self._ability = ability
        self.DeclareAbstractInputPort("features", AbstractValue.Make(object()))
        self.DeclareVectorInputPort("traversability", rectangles)
        self.DeclareAbstractOutputPort(
            "histogram", lambda: AbstractValue.Make(object()), weak_method(self._CalcHistogram)
        )

    def _CalcHistogram(self, context: Context, output: AbstractValue) -> None:
        features = eval_typed(self, context, "features", TerrainFeatureTable)
        traversability = eval_typed(self, context, "traversability", np.ndarray)
        if len(features.directions) != len(traversability):
            where, found = "PolarRiskHistogram.features", len(features.directions)
            raise PortError("wrong number of rectangles", where=where, value=found, valid=str(len(traversability)))
        output.set_value(make_histogram(features, traversability, self._ability))
