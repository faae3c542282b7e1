"""Traversability of the ground ahead by fuzzy inference, as a system."""

from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from ..ports import eval_typed
from .ability import Ability, check_ability
from .features import TerrainFeatureTable
from .mamdani import Mamdani


class FuzzyTraversability(LeafSystem):
    """
    .. pydrake_system::

        name: FuzzyTraversability
        input_ports:
        - features
        output_ports:
        - traversability

    Infers how well the robot can drive over the ground in each rectangle (row S3-b, Eq. 7): pitch slope, roll slope and
    roughness → SMALL, MEDIUM, LARGE → 27 rules → POOR, LOW, MODERATE, HIGH → τ by min-max-centroid, see `Mamdani`.
    What a robot can do is in its memberships: the same ground is passable for one and not for another.

    - `features` (`TerrainFeatureTable`): of K rectangles.
    - `traversability` (K): τ of each; the lowest there is where a feature is not known.

    Args:
        ability: of the robot. rectangles: K.

    Raises:
        ConfigError: a membership, rule or limit of the ability cannot be used.
        PortError: the input is not connected or of another type.
    """

    def __init__(self, ability: Ability, rectangles: int = 9):
        super().__init__()
        check_ability(ability)
        self._inference = Mamdani(ability.fuzzy)
        self.DeclareAbstractInputPort("features", AbstractValue.Make(object()))
        self.DeclareVectorOutputPort("traversability", rectangles, self._CalcTraversability)

    def _CalcTraversability(self, context: Context, output: BasicVector) -> None:
        features = eval_typed(self, context, "features", TerrainFeatureTable)
        output.SetFromVector(self._inference.infer(features.inputs).traversability)
