"""Campaigns, on a stand-in for the command that leaves metrics as a mission does."""

import csv
import json
import sys

import pytest
from naraha.diagrams.campaign import Campaign, parse_grid, run_campaign
from naraha.systems.errors import InputError

# Leaves error = noise · (1 + seed), fails for seed 3, notes every call, and is bad input for a negative noise.
MISSION = """
import json, pathlib, sys
words = sys.argv[1:]
option = lambda name: words[words.index(name) + 1]
settings = dict(w.split("=") for i, w in enumerate(words) if words[i - 1] == "--set")
noise, seed = float(settings.get("noise", 1)), int(option("--seed"))
if noise < 0:
    print("naraha: noise: out of range", file=sys.stderr); sys.exit(2)
out = pathlib.Path(option("--out")); out.mkdir(parents=True, exist_ok=True)
with (pathlib.Path(__file__).parent / "calls").open("a") as calls:
    calls.write(" ".join(words) + "\\n")
status = "failed" if seed == 3 else "done"
metrics = {"status": status, "reason": "why", "seed": seed, "error_m": noise * (1 + seed), "name": "x"}
(out / "metrics.json").write_text(json.dumps(metrics))
sys.exit(status != "done")
"""


@pytest.fixture
def campaign(tmp_path):
    script = tmp_path / "mission.py"
    script.write_text(MISSION)

    def make(**changes):
        common = {"mission": "survey", "arguments": ["hall"], "runs": 2, "out": tmp_path / "out"}
        return Campaign(**{**common, "command": (sys.executable, str(script)), **changes})

    make.calls = lambda: (tmp_path / "calls").read_text().splitlines()
    return make


def table(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def test_every_seed_is_run_at_every_point_and_lands_in_one_table(campaign):
    one = campaign(grid=parse_grid(["noise=[1, 2.5]"]), jobs=2)
    assert run_campaign(one) == 0
    runs = table(one.out / "runs.csv")
    assert [(r["noise"], r["seed"], float(r["error_m"])) for r in runs] == [
        ("1", "0", 1.0),
        ("1", "1", 2.0),
        ("2.5", "0", 2.5),
        ("2.5", "1", 5.0),
    ]
    for run in runs:
        assert json.loads((one.out / run["folder"] / "metrics.json").read_text())["error_m"] == float(run["error_m"])
    (first, second) = (r for r in table(one.out / "summary.csv") if r["metric"] == "error_m")
    assert (first["noise"], float(first["mean"]), float(first["deviation"])) == ("1", 1.5, 0.5)
    assert (second["noise"], float(second["min"]), float(second["max"])) == ("2.5", 2.5, 5.0)
    assert all(call.startswith("survey hall --set noise=") for call in campaign.calls())


def test_what_has_ended_is_not_run_again_and_a_wider_campaign_runs_the_rest(campaign):
    assert run_campaign(campaign()) == 0
    assert run_campaign(campaign()) == 0
    assert len(campaign.calls()) == 2
    interrupted = campaign().all_runs()[0].folder / "metrics.json"
    interrupted.write_text(json.dumps({"status": "interrupted"}))
    assert run_campaign(campaign(runs=3)) == 0
    assert sorted(call.split("--seed ")[1][0] for call in campaign.calls()) == ["0", "0", "1", "2"]


def test_a_failed_run_is_reported_and_does_not_count(campaign):
    one = campaign(runs=1, first_seed=3)
    assert run_campaign(one) == 1
    assert table(one.out / "runs.csv")[0]["status"] == "failed"
    assert table(one.out / "summary.csv") == []


def test_bad_input_of_the_mission_is_bad_input_of_the_campaign(campaign):
    with pytest.raises(InputError, match="noise: out of range"):
        run_campaign(campaign(grid={"noise": ["-1"]}))


@pytest.mark.parametrize("grid", ["noise", "=1", "noise=1", "noise=[]", "noise=[1", "noise: 3"])
def test_a_grid_that_is_none_says_what_one_is(grid):
    with pytest.raises(InputError, match=r"--grid .*valid: path=\[value, value\]"):
        parse_grid([grid])


def test_values_of_a_grid_are_yaml(campaign):
    grid = parse_grid(["a.b=[null, [1, 2], text]"])
    assert grid == {"a.b": ["null", "[1, 2]", '"text"']}
    with pytest.raises(InputError, match="given twice"):
        parse_grid(["a=[1]", "a=[2]"])


@pytest.mark.parametrize("change", [{"runs": 0}, {"jobs": 0}, {"backend": "threads"}])
def test_what_cannot_be_run_is_refused_before_anything_runs(campaign, change):
    one = campaign(**change)
    with pytest.raises(InputError, match="--"):
        run_campaign(one)
    assert not one.out.exists()
