"""One measuring run in physics, from start to end."""

import math

from naraha.systems.placement import FloorPlan
from pydrake.systems.analysis import Simulator

from .illuminate_log import IlluminateLog, RunRecord
from .illuminate_station import MeasuringRoute, MeasuringRunConfig, make_illuminate
from .mission import Ending

STEP = 0.1
"""[s] between two looks at a run."""


def run_once(
    config: MeasuringRunConfig, plan: FloorPlan, way: MeasuringRoute, seed: int, slam_limit: float
) -> RunRecord:
    """Drives the route in physics until all is measured, localisation has failed, or the time is over.

    Args:
        seed: of all noise. slam_limit: error of the believed position at which the run has failed [m].
    """
    diagram = make_illuminate(config, plan, way, seed=seed)
    log = IlluminateLog(diagram, plan, way, slam_limit=slam_limit)
    simulator = Simulator(diagram)
    simulator.Initialize()
    context = simulator.get_context()
    ending = log.step(context)
    steps = math.ceil(config.duration / STEP - 1e-9)
    for i in range(1, steps + 1):
        if ending is not None:
            break
        simulator.AdvanceTo(i * STEP)
        ending = log.step(context)
    return log.record(ending or Ending("done", f"the time budget of {config.duration:g} s is over"))
