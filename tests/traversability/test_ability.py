"""Abilities as files."""

import pytest
from naraha.models import MODELS_DIR
from naraha.systems.errors import ConfigError
from naraha.systems.traversability import Ability, read_ability, write_ability

SHIPPED = sorted(MODELS_DIR.glob("*/ability.yaml")) + sorted(MODELS_DIR.glob("*/paper.yaml"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_every_shipped_ability_can_be_read_and_says_whose_it_is(path):
    ability = read_ability(path)
    assert ability.robot == path.parent.name
    assert ability.source


def test_an_ability_is_read_back_as_it_was_written(tmp_path):
    ability = Ability(robot="x", source="y", step_threshold=0.123)
    write_ability(tmp_path / "a.yaml", ability)
    assert read_ability(tmp_path / "a.yaml") == ability


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("step_threshold: -1", "a.yaml: step_threshold: out of range"),
        ("stepp: 1", "a.yaml: not an ability"),
        ("[1]", "a.yaml: not an ability"),
        ("fuzzy: {rules: []}", "a.yaml: fuzzy.rules: a rule is missing"),
        ("footprint: [1, 2, 3]", "a.yaml: footprint: wrong length"),
    ],
)
def test_what_is_wrong_is_named_with_its_file(tmp_path, text, words):
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(ConfigError, match=words):
        read_ability(tmp_path / "a.yaml")
    with pytest.raises(ConfigError, match=r"b\.yaml"):
        read_ability(tmp_path / "b.yaml")
