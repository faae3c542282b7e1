"""The operator at the terminal: the table of routes, answers, and the end of the input."""

import io
import json

import numpy as np
import pytest
from naraha.diagrams.cli import app
from naraha.diagrams.operator import ask, route_table
from naraha.systems.errors import ConfigError, InputError
from naraha.systems.routes import find_routes
from rich.console import Console
from typer.testing import CliRunner

from tests.routes.maps import water_map

QUICK = ["loop.survey.frontiers.look_time=1", "loop.survey.frontiers.min_gain=8", "baseline=null", "recording=null"]


@pytest.fixture(scope="module")
def routes():
    grid, start, goal = water_map(0)
    found = find_routes(grid, start, np.array(goal))
    assert len(found) >= 2
    return found


def prompted(monkeypatch, routes, *answers):
    left = list(answers)

    def answer(question):
        assert f"1 to {len(routes)}" in question
        if not left:
            raise EOFError
        return left.pop(0)

    monkeypatch.setattr("builtins.input", answer)
    chosen = ask(routes, 12.0)
    assert not left
    return chosen


def test_the_table_says_of_every_route_what_it_costs_and_how_sure_it_is(routes):
    console = Console(width=160, record=True, file=io.StringIO())
    console.print(route_table(routes))
    lines = console.export_text().splitlines()
    for number, route in enumerate(routes, 1):
        line = next(line for line in lines if f" {number} " in line and f"{route.length_m:.1f} m" in line)
        for part in (f"{route.time_s:.0f} s", f"{route.clearance_m:.2f} m", f"{100 * route.confidence:.0f} %", "µSv"):
            assert part in line
        assert all(side in line for side in route.sides)
    for name in ("length", "time", "clearance", "dose", "tilt", "how sure"):
        assert name in lines[1]


def test_only_a_number_of_the_table_chooses(monkeypatch, routes, capsys):
    assert prompted(monkeypatch, routes, "0", "x", "-1", str(len(routes) + 1), "1.0", " 2 ") == 1
    assert "12 s: routes to" in capsys.readouterr().out


def test_an_empty_line_stops(monkeypatch, routes):
    assert prompted(monkeypatch, routes, "") is None


def run_survey(out, *arguments, answers=""):
    settings = [word for setting in QUICK for word in ("--set", setting)]
    command = ["survey", "stair_hall_loop", "--operator", "prompt", "--out", str(out), *settings, *arguments]
    result = CliRunner().invoke(app, command, input=answers)
    return result, json.loads((out / "metrics.json").read_text())


def test_an_answer_starts_the_leg_and_the_end_of_the_input_ends_the_mission(tmp_path):
    result, metrics = run_survey(tmp_path, answers="seven\n1\n")
    assert result.exit_code == 1
    assert result.stdout.count("Which one, 1 to") >= 3
    assert metrics["status"] == "failed"
    assert metrics["reason"].startswith("the operator's input ended at")
    assert metrics["legs"] + metrics["goals_passed"] + metrics["routes_closed"] >= 1
    assert (tmp_path / "survey_map.ply").exists()


def test_a_tour_has_nothing_to_choose(tmp_path):
    result = CliRunner().invoke(app, ["survey", "stair_hall", "--operator", "prompt", "--out", str(tmp_path / "out")])
    assert isinstance(result.exception, InputError)
    assert "--operator" in str(result.exception)


def test_an_unknown_operator_is_refused(tmp_path):
    result = CliRunner().invoke(app, ["survey", "stair_hall_loop", "--operator", "me", "--out", str(tmp_path / "out")])
    assert isinstance(result.exception, ConfigError)
    assert "auto" in str(result.exception)
