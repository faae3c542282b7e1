"""Running examples of the systems that plan routes and landmarks."""

from naraha.systems.placement import (
    CoEvolution,
    CoEvolutionConfig,
    EvolutionConfig,
    GrowingCells,
    LandmarkExtractor,
    TopologyConfig,
)
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import DiagramBuilder, LeafSystem, System
from pydrake.systems.primitives import ConstantValueSource

from .halls import hall, small_problem


def planning(name: str, seed: int) -> tuple[System, LeafSystem]:
    """The whole planning of a small hall; returns the system of that name in it."""
    config = CoEvolutionConfig(problem=small_problem().config, evolution=EvolutionConfig(generations=4, seed=seed))
    builder = DiagramBuilder()
    plan = builder.AddSystem(ConstantValueSource(AbstractValue.Make(hall()))).get_output_port()
    extractor = builder.AddSystem(LandmarkExtractor())
    cells = builder.AddSystem(GrowingCells(TopologyConfig(seed=seed)))
    evolution = builder.AddSystem(CoEvolution(config))
    for system in (extractor, cells, evolution):
        builder.Connect(plan, system.GetInputPort("floor_plan"))
    builder.Connect(extractor.get_output_port(), evolution.GetInputPort("landmarks"))
    builder.Connect(cells.get_output_port(), evolution.GetInputPort("topology"))
    systems = {type(system).__name__: system for system in (extractor, cells, evolution)}
    return builder.Build(), systems[name]


PLACEMENT_EXAMPLES = {
    name: lambda seed, name=name: planning(name, seed) for name in ("CoEvolution", "GrowingCells", "LandmarkExtractor")
}
