"""The system that plans a route and the landmarks that are added for it."""

from dataclasses import dataclass, field
from typing import Any

from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, LeafSystem

from ..config import check_config, quantity
from ..ports import eval_typed, weak_method
from .candidate_sites import find_sites, initial_route
from .evolution_config import EvolutionConfig
from .evolve import evolve
from .floor_plan import FloorPlan
from .landmarks import LandmarkMap
from .problem import ProblemConfig, problem_with
from .topology import Topology


@dataclass(kw_only=True)
class CoEvolutionConfig:
    """What is planned for, and how."""

    problem: ProblemConfig = field(default_factory=ProblemConfig)
    evolution: EvolutionConfig = field(default_factory=EvolutionConfig)
    # [-] Least share of the sites that get a landmark.
    least_share: float = quantity(0.0, low=0, high=1)


class CoEvolution(LeafSystem):
    """
    .. pydrake_system::

        name: CoEvolution
        input_ports:
        - floor_plan
        - landmarks
        - topology
        output_ports:
        - placement_problem
        - placement

    Lets routes through the measuring points of `floor_plan` (`FloorPlan`) and sets of added landmarks evolve together
    (rows S4-c and S4-d), with the plan's own `landmarks` (`LandmarkMap`) and its `topology` (`Topology`).

    - `placement_problem` (`PlacementProblem`): where landmarks may be added, all ways, and what is seen along them.
    - `placement` (`Placement`): the route in W [m], the boxes that are put up, and how the evolution went; see
      `evolve`.

    Both are computed when they are asked for, and again when an input is another; no state.

    Raises:
        ConfigError: a value of the configuration is out of range.
        PlanError: when an output is asked for: no place for a landmark, or no way to a point.
        PortError: an input is not connected or of another type.
    """

    def __init__(self, config: CoEvolutionConfig | None = None):
        super().__init__()
        self._config = config or CoEvolutionConfig()
        check_config(self._config, key="co_evolution")
        for name in ("floor_plan", "landmarks", "topology"):
            self.DeclareAbstractInputPort(name, AbstractValue.Make(object()))
        for name, calc in (("placement_problem", self._CalcProblem), ("placement", self._CalcPlacement)):
            self.DeclareAbstractOutputPort(name, lambda: AbstractValue.Make(object()), weak_method(calc))

    def _CalcProblem(self, context: Context, output: AbstractValue) -> None:
        plan = eval_typed(self, context, "floor_plan", FloorPlan)
        landmarks = eval_typed(self, context, "landmarks", LandmarkMap)
        topology = eval_typed(self, context, "topology", Topology)
        of = self._config.problem
        sites = find_sites(plan, topology, initial_route(topology), landmarks.positions, of.sites)
        output.set_value(problem_with(plan, topology, landmarks, sites, of))

    def _CalcPlacement(self, context: Context, output: AbstractValue) -> None:
        problem: Any = self.GetOutputPort("placement_problem").Eval(context)
        least = round(self._config.least_share * len(problem.sites))
        output.set_value(evolve(problem, self._config.evolution, least=least))
