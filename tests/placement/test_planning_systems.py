"""The planning systems: what they say is what the functions say, and wrong inputs are named."""

import numpy as np
import pytest
from naraha.systems.errors import ConfigError, PlanError, PortError
from naraha.systems.placement import CoEvolution, CoEvolutionConfig, EvolutionConfig, GrowingCells, find_landmarks
from pydrake.common.value import AbstractValue

from .halls import hall
from .placement_examples import planning


def test_the_systems_plan_as_the_functions_do():
    diagram, evolution = planning("CoEvolution", 3)
    context = diagram.CreateDefaultContext()
    mine = evolution.GetMyContextFromRoot(context)
    problem = evolution.GetOutputPort("placement_problem").Eval(mine)
    placement = evolution.GetOutputPort("placement").Eval(mine)
    assert evolution.GetOutputPort("placement_problem").Eval(mine) is problem  # once, not again
    assert (problem.landmarks.positions == find_landmarks(hall()).positions).all()
    assert sorted(placement.order) == list(range(1, 7))
    assert placement.route[placement.stops] == pytest.approx(problem.plan.measuring_points[placement.order - 1])


def test_a_lower_bound_is_kept():
    diagram, _ = planning("CoEvolution", 0)
    evolution = CoEvolution(CoEvolutionConfig(least_share=0.5, evolution=EvolutionConfig(generations=2)))
    context = evolution.CreateDefaultContext()
    root = diagram.CreateDefaultContext()
    values = {"floor_plan": hall()}
    for system in diagram.GetSystems():
        for name in ("landmarks", "topology"):
            if system.HasOutputPort(name):
                values[name] = system.GetOutputPort(name).Eval(system.GetMyContextFromRoot(root))
    for name, value in values.items():
        evolution.GetInputPort(name).FixValue(context, AbstractValue.Make(value))
    sites = len(evolution.GetOutputPort("placement_problem").Eval(context).sites)
    assert evolution.GetOutputPort("placement").Eval(context).chosen.sum() >= round(0.5 * sites)


def test_wrong_inputs_are_named():
    cells = GrowingCells()
    context = cells.CreateDefaultContext()
    with pytest.raises(PortError, match=r"GrowingCells\.floor_plan"):
        cells.GetOutputPort("topology").Eval(context)
    cells.GetInputPort("floor_plan").FixValue(context, AbstractValue.Make(EvolutionConfig()))
    with pytest.raises(PortError, match=r"floor_plan: wrong type.*FloorPlan"):
        cells.GetOutputPort("topology").Eval(context)
    in_wall = hall(points=np.array([[18.0, 0.1]]))
    cells.GetInputPort("floor_plan").FixValue(context, AbstractValue.Make(in_wall))
    with pytest.raises(PlanError, match=r"measuring_points\[0\].*inside a wall"):
        cells.GetOutputPort("topology").Eval(context)
    with pytest.raises(ConfigError, match=r"co_evolution\.evolution\.flip"):
        CoEvolution(CoEvolutionConfig(evolution=EvolutionConfig(flip=2.0)))
