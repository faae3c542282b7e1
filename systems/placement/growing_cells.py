"""The system that grows cells over the free space of a floor plan."""

from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, LeafSystem

from ..config import check_config
from ..ports import eval_typed, weak_method
from .floor_plan import FloorPlan
from .topology import TopologyConfig, grow_topology


class GrowingCells(LeafSystem):
    """
    .. pydrake_system::

        name: GrowingCells
        input_ports:
        - floor_plan
        output_ports:
        - topology

    Grows cells over the free space of `floor_plan` (`FloorPlan`) and links them where the robot can drive straight,
    with the start and the measuring points joined: Growing Cell Structures (row S4-b; see `grow_topology`). `topology`
    (`Topology`) is that graph, positions in W [m]. It is computed when it is asked for, and again when the plan is
    another.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PlanError: when the output is asked for: start or measuring points are not free or cannot be reached.
        PortError: the input is not connected or of another type.
    """

    def __init__(self, config: TopologyConfig | None = None):
        super().__init__()
        self._config = config or TopologyConfig()
        check_config(self._config, key="growing_cells")
        self.DeclareAbstractInputPort("floor_plan", AbstractValue.Make(object()))
        self.DeclareAbstractOutputPort("topology", lambda: AbstractValue.Make(object()), weak_method(self._Calc))

    def _Calc(self, context: Context, output: AbstractValue) -> None:
        output.set_value(grow_topology(eval_typed(self, context, "floor_plan", FloorPlan), self._config))
