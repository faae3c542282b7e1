"""The system that finds the landmarks of a floor plan."""

from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, LeafSystem

from ..config import check_config
from ..ports import eval_typed, weak_method
from .floor_plan import FloorPlan
from .landmarks import LandmarkConfig, find_landmarks


class LandmarkExtractor(LeafSystem):
    """
    .. pydrake_system::

        name: LandmarkExtractor
        input_ports:
        - floor_plan
        output_ports:
        - landmarks

    Finds the landmarks of `floor_plan` (`FloorPlan`): corners, ends of walls and small things, where walls that run in
    different directions meet (row S4-a; see `find_landmarks`). `landmarks` (`LandmarkMap`) has their positions in W [m]
    and from where each is seen. It is computed when it is asked for, and again when the plan is another.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PortError: the input is not connected or of another type.
    """

    def __init__(self, config: LandmarkConfig | None = None):
        super().__init__()
        self._config = config or LandmarkConfig()
        check_config(self._config, key="landmark_extractor")
        self.DeclareAbstractInputPort("floor_plan", AbstractValue.Make(object()))
        self.DeclareAbstractOutputPort("landmarks", lambda: AbstractValue.Make(object()), weak_method(self._Calc))

    def _Calc(self, context: Context, output: AbstractValue) -> None:
        output.set_value(find_landmarks(eval_typed(self, context, "floor_plan", FloorPlan), self._config))
