"""LeafSystem that offers several really different routes to a goal."""

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import Context, LeafSystem

from ..config import check_config
from ..errors import InputError
from ..ports import eval_typed, weak_method
from .find_routes import find_routes
from .motion_model import MotionModel
from .route_config import RoutesConfig
from .route_grid import RouteGrid


class DistinctRoutes(LeafSystem):
    """
    .. pydrake_system::

        name: DistinctRoutes
        input_ports:
        - route_grid
        - start
        - goal
        output_ports:
        - routes
        - status

    Offers routes from which an operator chooses (rows S0-h, S0-i): left and right of the water, told apart by the
    islands that they pass, see `find_routes`. It has no state: routes are looked for when they are asked for, once for
    the same inputs.

    - `route_grid` (`RouteGrid`): where the robot can go.
    - `start` (3): x, y, heading in M [m, m, rad]; `goal` (2): x, y in M [m].
    - `routes` (tuple of `Route`): the best first, at most `most`; empty when no way leads there.
    - `status` (str): "" with routes, or why there are none: start or goal not free (with the nearest free cell), or no
      way between them.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PortError: an input is not connected or of another type.
    """

    def __init__(self, config: RoutesConfig | None = None, *, motion: MotionModel | None = None):
        super().__init__()
        self._config, self._motion = config or RoutesConfig(), motion
        check_config(self._config, key="routes")
        self.DeclareAbstractInputPort("route_grid", AbstractValue.Make(object()))
        self.DeclareVectorInputPort("start", 3)
        self.DeclareVectorInputPort("goal", 2)
        needs = {self.all_input_ports_ticket()}
        self.DeclareAbstractOutputPort("routes", lambda: AbstractValue.Make(()), weak_method(self._CalcRoutes), needs)
        self.DeclareAbstractOutputPort("status", lambda: Value[str](), weak_method(self._CalcStatus), needs)

    def _inputs(self, context: Context) -> tuple[RouteGrid, np.ndarray, np.ndarray]:
        grid = eval_typed(self, context, "route_grid", RouteGrid)
        start, goal = (eval_typed(self, context, name, np.ndarray) for name in ("start", "goal"))
        return grid, start, goal

    def _CalcRoutes(self, context: Context, output: AbstractValue) -> None:
        grid, start, goal = self._inputs(context)
        try:
            output.set_value(find_routes(grid, start, goal, self._config, motion=self._motion))
        except InputError:  # `status` says which
            output.set_value(())

    def _CalcStatus(self, context: Context, output: AbstractValue) -> None:
        grid, start, goal = self._inputs(context)
        if self.GetOutputPort("routes").Eval(context):
            output.set_value("")
            return
        try:
            first, last = grid.free_index_of(start[:2], "start"), grid.free_index_of(goal, "goal")
            same = bool((first == last).all())
            output.set_value("the robot is at the goal" if same else "no way leads from start to goal")
        except InputError as error:
            output.set_value(str(error))
