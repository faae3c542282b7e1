import pytest
from naraha.models.worlds.stuck import KINDS
from naraha.systems.errors import ConfigError
from naraha.systems.snake.snake_pilot import Move
from naraha.systems.snake.stuck_detector import StuckDetectorConfig

from tests.snake.stuck_snake import driven, settled


@pytest.mark.parametrize("kind", KINDS)
def test_a_stuck_snake_is_noticed_with_class_and_place(kind):
    case, run = settled(kind, 2)
    assert not run.read("detector.diagnosis").stuck
    driven(run, 2.5)
    diagnosis = run.read("detector.diagnosis")
    assert diagnosis.stuck
    assert diagnosis.kind == kind
    assert abs(diagnosis.unit - case.unit) <= 1


@pytest.mark.parametrize("kind", [1, 2, 3, 4])
def test_a_snake_that_drives_in_a_world_that_looks_alike_is_not_said_to_be_stuck(kind):
    _, run = settled(kind, 2, stuck=False)
    for _ in range(5):
        driven(run, 0.5)
        assert not run.read("detector.diagnosis").stuck


def test_the_answer_stands_while_the_wheels_rest():
    _, run = settled(1, 0)
    driven(run, 2.0)
    before = run.read("detector.diagnosis")
    run.give(Move())
    run.advance(0.5)
    assert before.stuck
    assert run.read("detector.diagnosis").kind == before.kind


def test_values_out_of_range_are_refused():
    with pytest.raises(ConfigError, match=r"stuck_detector\.window"):
        settled(1, 0, detector=StuckDetectorConfig(window=0.0))
