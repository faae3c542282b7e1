import numpy as np
import pytest
from naraha.systems.errors import ConfigError
from naraha.systems.snake.recovery_motion import RecoveryCommand
from naraha.systems.snake.snake_pilot import Move

from tests.snake.stuck_snake import driven, settled


def test_a_move_is_checked_when_it_is_made():
    with pytest.raises(ConfigError, match=r"move\.kind"):
        Move(kind="fly")
    with pytest.raises(ConfigError, match="segment and a target"):
        Move(kind="recover")
    with pytest.raises(ConfigError, match=r"move\.speed"):
        Move(kind="wheels", speed=np.nan)


def test_each_kind_of_move_drives_joints_and_wheels_as_it_says():
    _, run = settled(1, 0, stuck=False, sensors=False)
    assert driven(run, 1.0) > 0.08
    assert run.read("pilot.mode") == "wheels"
    np.testing.assert_allclose(run.read("pilot.wheel_speed_command"), 2.0)
    run.give(Move())
    run.advance(0.5)
    x = run.head()
    run.advance(0.5)
    assert np.linalg.norm(run.head() - x) < 1e-3
    run.give(Move(kind="shift", speed=-0.1))
    run.advance(1.0)
    assert (run.head() - x)[0] < -0.08
    joints = np.zeros(19)
    joints[6] = 0.3
    run.give(Move(joints=tuple(joints)))
    run.advance(1.0)
    assert run.read("station.joint_angles")[6] == pytest.approx(0.3, abs=0.05)  # it sags under its weight


def test_relaxing_takes_the_load_off_a_wedged_bend():
    _, run = settled(2, 0, sensors=False)
    before = np.abs(run.read("station.joint_torques")).max()
    run.give(Move(kind="relax"))
    run.advance(1.2)
    assert np.abs(run.read("station.joint_torques")).max() < 0.5 * before


def test_a_recovery_runs_and_is_stopped_by_the_next_move():
    case, run = settled(1, 0, sensors=False)
    command = RecoveryCommand(first_unit=case.unit - 2, last_unit=case.unit + 2, target=(-0.9, 0.0, 0.18))
    run.give(Move(kind="recover", recovery=command))
    run.advance(1.0)
    assert run.read("recovery.status").phase == "moving"
    run.give(Move())
    run.advance(0.1)
    assert run.read("recovery.status").phase == "stopped"


def test_the_wrong_number_of_angles_is_refused():
    _, run = settled(1, 0, sensors=False)
    run.give(Move(joints=(0.0, 0.1)))
    with pytest.raises(ConfigError, match=r"move\.joints"):
        run.advance(0.05)
