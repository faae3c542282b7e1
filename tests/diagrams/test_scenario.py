from dataclasses import dataclass, field

import pytest
from naraha.diagrams.calibrate import CalibrateScenario
from naraha.diagrams.extrinsics import ExtrinsicsScenario
from naraha.diagrams.illuminate import IlluminateScenario
from naraha.diagrams.learn import LearnScenario
from naraha.diagrams.mapping import MapScenario
from naraha.diagrams.merging import MergeScenario
from naraha.diagrams.recover import RecoverScenario
from naraha.diagrams.scenario import dump_scenario, load_scenario, shipped_scenarios
from naraha.diagrams.survey import SurveyScenario
from naraha.diagrams.traverse import TraverseScenario
from naraha.systems.config import quantity
from naraha.systems.errors import InputError
from pydrake.common.yaml import yaml_dump_typed


@dataclass(kw_only=True)
class Wheel:
    radius: float = quantity(0.1, unit="m", above=0)


@dataclass(kw_only=True)
class Cart:
    seed: int = 0
    name: str = "cart"
    wheels: list[Wheel] = field(default_factory=list)
    spare: Wheel | None = None
    labels: dict[str, Wheel] = field(default_factory=dict)


def load(tmp_path, text, settings=(), seed=None):
    path = tmp_path / "cart.yaml"
    path.write_text(text)
    return load_scenario(Cart, str(path), settings, seed)


def test_what_the_file_does_not_say_keeps_its_default(tmp_path):
    cart = load(tmp_path, "wheels: [{radius: 0.2}, {}]")
    assert cart == Cart(wheels=[Wheel(radius=0.2), Wheel()])


def test_settings_reach_any_depth_and_the_last_one_wins(tmp_path):
    settings = ["spare.radius=0.3", "spare.radius=0.4", "wheels=[{radius: 1}]", "labels.front.radius=2", "name=new"]
    cart = load(tmp_path, "wheels: []", settings, seed=7)
    assert cart == Cart(
        seed=7, name="new", wheels=[Wheel(radius=1.0)], spare=Wheel(radius=0.4), labels={"front": Wheel(radius=2.0)}
    )


def test_null_switches_a_feature_off(tmp_path):
    assert load(tmp_path, "spare: {radius: 1}", ["spare=null"]).spare is None


@pytest.mark.parametrize(
    ("text", "settings", "message"),
    [
        ("wheel: []", (), r"cart\.yaml: wheel: unknown key; did you mean 'wheels'\? \(valid: labels, name"),
        ("wheels: [{}, {radus: 1}]", (), r"cart\.yaml: wheels\[1\]\.radus: unknown key; did you mean 'radius'"),
        ("labels: {a: {x: 1}}", (), r"labels\.a\.x: unknown key"),
        ("spare: {radius: -1}", (), r"cart\.yaml: spare\.radius: out of range, got -1\.0 \(valid: > 0 m\)"),
        ("spare: {radius: .nan}", (), r"spare\.radius: out of range"),
        ("spare: {radius: big}", (), r"cart\.yaml: wrong type"),
        ("wheels: 3", (), r"cart\.yaml: wrong type"),
        ("- a list", (), r"cart\.yaml: not a scenario"),
        ("", (), r"cart\.yaml: not a scenario"),
        ("a: [", (), r"cart\.yaml: not YAML"),
        ("name: a", ("spare.colour=1",), r"--set spare\.colour=1: spare\.colour: unknown key"),
        ("name: a", ("spare",), r"--set spare: not a setting.*path=value"),
        ("name: a", ("name=[",), r"--set name=\[: value is not YAML"),
    ],
)
def test_a_mistake_is_one_line_with_file_key_and_valid_values(tmp_path, text, settings, message):
    with pytest.raises(InputError, match=message) as caught:
        load(tmp_path, text, settings)
    assert "\n" not in str(caught.value)


def test_a_missing_scenario_names_the_shipped_ones():
    with pytest.raises(InputError, match=r"nowhere: no such scenario or file.*corridor.*rough.*stair_hall"):
        load_scenario(SurveyScenario, "nowhere")


# What a shipped scenario is for; a survey when it is not named here.
SCHEMAS = {
    "extrinsics": ExtrinsicsScenario,
    "recorded": MapScenario,
    "recorded_gicp": MapScenario,
    "viewpoints": MergeScenario,
    "calibrate": CalibrateScenario,
    "e2827": TraverseScenario,
    "real_like": TraverseScenario,
    "learn": LearnScenario,
    "stuck": RecoverScenario,
    "construction_hall": IlluminateScenario,
    "construction_hall_paper": IlluminateScenario,
    "construction_hall_paper_mapping": IlluminateScenario,
    "construction_hall_unplanned": IlluminateScenario,
    "gallery": IlluminateScenario,
    "workshop": IlluminateScenario,
}


@pytest.mark.parametrize("name", shipped_scenarios())
def test_a_resolved_scenario_loads_as_it_was_saved(name, tmp_path):
    schema = SCHEMAS.get(name, SurveyScenario)
    scenario = load_scenario(schema, name, seed=3)
    path = tmp_path / "resolved.yaml"
    path.write_text(dump_scenario(scenario))
    again = load_scenario(schema, str(path))
    assert yaml_dump_typed(again) == yaml_dump_typed(scenario)
    assert again.seed == 3
    assert scenario.description


def test_what_was_switched_off_stays_off(tmp_path):
    scenario = load_scenario(
        SurveyScenario, "stair_hall", ["recording=null", "lidar=null", "fusion.water.threshold=null"]
    )
    path = tmp_path / "resolved.yaml"
    path.write_text(dump_scenario(scenario))
    again = load_scenario(SurveyScenario, str(path))
    assert again.recording is None
    assert again.lidar is None
    assert again.fusion.water.threshold is None
    assert dump_scenario(again) == dump_scenario(scenario)


def test_the_file_of_a_robot_holds_where_the_scenario_says_nothing(tmp_path):
    base = tmp_path / "robot.yaml"
    base.write_text("spare: {radius: 0.7}\nname: base\nlegs: 4\n")
    path = tmp_path / "cart.yaml"
    path.write_text("name: mine\n")
    cart = load_scenario(Cart, str(path), ["labels.a.radius=2"], base=base)
    assert cart == Cart(name="mine", spare=Wheel(radius=0.7), labels={"a": Wheel(radius=2.0)})
    base.write_text("spare: {radus: 0.7}\n")
    with pytest.raises(InputError, match=r"robot\.yaml: spare\.radus: unknown key"):
        load_scenario(Cart, str(path), base=base)


def test_a_scenario_extends_another_one(tmp_path):
    (tmp_path / "first.yaml").write_text("name: first\nspare: {radius: 0.7}\n")
    second = tmp_path / "second.yaml"
    second.write_text(f"extends: {tmp_path / 'first.yaml'}\nname: second\n")
    assert load_scenario(Cart, str(second)) == Cart(name="second", spare=Wheel(radius=0.7))
    (tmp_path / "first.yaml").write_text("spare: {radus: 0.7}\n")
    with pytest.raises(InputError, match=r"first\.yaml: spare\.radus: unknown key"):
        load_scenario(Cart, str(second))
    second.write_text(f"extends: {second}\n")
    with pytest.raises(InputError, match=r"second\.yaml: extends: extends itself"):
        load_scenario(Cart, str(second))
