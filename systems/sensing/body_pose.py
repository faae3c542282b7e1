"""The true pose of one body, for metrics and plots."""

from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context, LeafSystem

from ..ports import eval_typed, weak_method


class BodyPose(LeafSystem):
    """
    .. pydrake_system::

        name: BodyPose
        input_ports:
        - body_poses
        output_ports:
        - X_WB

    Picks one body's pose out of the MultibodyPlant's `body_poses`. It is ground truth: a station exports it as
    `cheat.X_WB`, and only metrics, plots and tests read it.

    - `X_WB` (RigidTransform): pose of the body in the world.
    """

    def __init__(self, body_index: BodyIndex):
        super().__init__()
        self._index = int(body_index)
        self.DeclareAbstractInputPort("body_poses", Value[list[RigidTransform]]())
        self.DeclareAbstractOutputPort("X_WB", lambda: Value(RigidTransform()), weak_method(self._CalcPose))

    @staticmethod
    def of(plant: MultibodyPlant, body: str, model: str) -> "BodyPose":
        """The pose of `body` of model instance `model`."""
        return BodyPose(plant.GetBodyByName(body, plant.GetModelInstanceByName(model)).index())

    def _CalcPose(self, context: Context, output: AbstractValue) -> None:
        output.set_value(eval_typed(self, context, "body_poses", list)[self._index])
