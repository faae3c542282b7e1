import json

import pytest
from naraha.diagrams.mission import Ending, Mission, Options, jsonable
from naraha.diagrams.scenario import load_scenario
from naraha.diagrams.survey import SurveyScenario
from naraha.systems.errors import InputError
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import LeafSystem


class Clock(LeafSystem):
    """Does nothing for `good` seconds and then raises `error`."""

    def __init__(self, good=10.0, error=None):
        super().__init__()
        self._good, self._error = good, error
        self.DeclarePeriodicDiscreteUpdateEvent(0.1, 0.0, self._tick)

    def _tick(self, context, discrete_state):
        if context.get_time() > self._good:
            raise self._error


def run(mission, system, duration=1.0, on_step=lambda context: None):
    return mission.simulate(
        Simulator(system), duration=duration, step=0.1, on_step=on_step, status_line=lambda context: ""
    )


@pytest.fixture
def mission(tmp_path):
    return Mission("clock", load_scenario(SurveyScenario, "stair_hall"), Options(out=tmp_path / "out"))


def read_metrics(mission):
    return json.loads(mission.path("metrics.json").read_text())


def test_a_run_ends_at_its_budget(mission):
    assert run(mission, Clock()) == Ending("done", "the time budget of 1 s is over")


def test_a_run_ends_when_the_step_says_so(mission):
    ending = Ending("done", "half a second is enough")
    assert run(mission, Clock(), on_step=lambda c: ending if c.get_time() >= 0.5 else None) is ending
    assert mission.finish(ending) == 0
    assert read_metrics(mission)["sim_time_s"] == pytest.approx(0.5)


@pytest.mark.parametrize("error", [RuntimeError("broken"), KeyError("broken"), ZeroDivisionError("broken")])
def test_an_error_in_the_middle_fails_the_mission_and_keeps_the_products(mission, error):
    ending = run(mission, Clock(0.45, error))
    assert ending.status == "failed"
    assert "broken" in ending.reason

    def write_map():
        mission.path("map.txt").write_text("measured")

    assert mission.finish(ending, write_map) == 1
    assert mission.path("map.txt").read_text() == "measured"
    metrics = read_metrics(mission)
    assert metrics["status"] == "failed"
    assert 0.4 < metrics["sim_time_s"] < 0.7


def test_a_product_that_fails_fails_the_mission_but_not_the_others(mission):
    def write_map():
        raise OSError("disk full")

    def write_trajectory():
        mission.path("trajectory.txt").write_text("measured")

    assert mission.finish(Ending("done", ""), write_map, write_trajectory) == 1
    assert mission.path("trajectory.txt").exists()
    assert read_metrics(mission)["reason"] == "write_map: disk full"


def test_metrics_are_valid_json_also_when_a_number_is_not_finite():
    assert jsonable({"a": float("nan"), "b": float("inf"), "c": 1.5}) == {"a": None, "b": None, "c": 1.5}


def test_an_output_folder_that_cannot_be_is_refused_before_the_run(tmp_path):
    (tmp_path / "file").write_text("")
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(InputError, match="not a folder"):
            Mission("clock", None, Options(out=out))
