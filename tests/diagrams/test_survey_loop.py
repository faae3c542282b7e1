"""The survey that finds its own way, for its shortest useful time, and what its metrics are made of."""

import numpy as np
import pytest
from naraha.diagrams.operator import Operator
from naraha.diagrams.scenario import load_scenario
from naraha.diagrams.survey import SurveyLog, SurveyScenario, make_survey
from naraha.diagrams.survey_loop import coverage
from naraha.models.worlds import load_world
from naraha.systems.errors import ConfigError
from pydrake.systems.analysis import Simulator

SHORT = ["loop.survey.time_budget=1", "loop.survey.frontiers.look_time=2", "recording=null"]


def test_a_survey_whose_time_is_over_after_the_first_look_is_done_at_home():
    scenario = load_scenario(SurveyScenario, "stair_hall_loop", SHORT, 0)
    diagram = make_survey(scenario)
    log, simulator = SurveyLog(scenario, diagram), Simulator(diagram)
    Operator(diagram, simulator.get_mutable_context())
    ending = None
    while ending is None and simulator.get_context().get_time() < 12.0:
        simulator.AdvanceTo(simulator.get_context().get_time() + scenario.slam.period)
        ending = log.step(simulator.get_context())
    assert ending is not None
    assert (ending.status, ending.reason) == ("done", "the time budget is over")
    metrics = log.metrics()
    assert metrics["returned_home"] == 1
    assert metrics["looks"] == 1
    assert metrics["legs"] == metrics["collisions"] == metrics["water_entries"] == 0
    assert 0.05 < metrics["coverage"] < 0.95
    assert "waypoints" not in metrics


def test_a_loop_without_a_semantic_map_is_refused():
    scenario = load_scenario(SurveyScenario, "stair_hall_loop", ["fusion=null"])
    with pytest.raises(ConfigError, match="semantic map"):
        make_survey(scenario)


def test_coverage_counts_the_share_of_the_reachable_floor():
    world = load_world("stair_hall", 0)
    x, y = np.meshgrid(np.arange(-10, 10, 0.1), np.arange(-7, 7, 0.1))
    floor = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    start = np.array([-8.0, -5.0])
    assert coverage(world, start, 0.5, floor) == 1.0
    west = floor[floor[:, 0] < 0]
    assert coverage(world, start, 0.5, west) == pytest.approx(0.5, abs=0.1)
    assert coverage(world, start, 0.5, np.zeros((0, 3))) == 0.0
