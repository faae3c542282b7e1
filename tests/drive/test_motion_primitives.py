import numpy as np
import pytest
from naraha.systems.drive import PRIMITIVES, MotionPrimitives, MotionPrimitivesConfig
from naraha.systems.drive.motion_primitives import (
    BACK,
    DONE,
    FAILED,
    FORWARD,
    LEFT,
    RIGHT,
    begin_motion,
    motion_twist,
    next_motion,
)
from naraha.systems.errors import ConfigError, InputError
from naraha.systems.routes import ACTIONS
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator

CONFIG = MotionPrimitivesConfig()


def drive(action, pose, config=CONFIG, slip=0.0, pull=0.0, most=20.0):
    """The pose at which a motion of a unicycle ends, and how; it turns by `pull` [rad/s] more than it is told."""
    pose, now = np.array(pose, float), 0.0
    motion = begin_motion(action, pose, now, config)
    while motion.phase not in (DONE, FAILED) and now < most:
        v, omega = motion_twist(motion, pose, config) * (1 - slip)
        omega += pull * (abs(v) > 0)
        pose += config.period * np.array([v * np.cos(pose[2]), v * np.sin(pose[2]), omega])
        now += config.period
        motion = next_motion(motion, pose, now, config)
    return pose, motion, now


def test_the_motions_are_those_that_are_learnt():
    assert PRIMITIVES == ACTIONS


@pytest.mark.parametrize(
    ("action", "start", "expected"),
    [
        (FORWARD, (1, 2, 0), (1.5, 2, 0)),
        (BACK, (1, 2, 0), (0.5, 2, 0)),
        (LEFT, (1, 2, 0), (1, 2, np.pi / 4)),
        (RIGHT, (1, 2, 0), (1, 2, -np.pi / 4)),
        (FORWARD, (1, 2, np.pi / 4), (1.5, 2.5, np.pi / 4)),
        (BACK, (1, 2, -3 * np.pi / 4), (1.5, 2.5, -3 * np.pi / 4)),
        (RIGHT, (1, 2, -np.pi), (1, 2, -5 * np.pi / 4)),
    ],
)
def test_a_motion_leads_one_cell_or_one_heading_on(action, start, expected):
    pose, motion, _ = drive(action, start)
    assert motion.phase == DONE
    assert pose == pytest.approx(expected, abs=0.025)


def test_headings_of_the_grid_keep_errors_from_adding_up():
    pose = np.array([0.0, 0.0, 0.15])
    for _ in range(8):
        pose, _, _ = drive(LEFT, pose)
    assert pose[2] == pytest.approx(2 * np.pi, abs=0.025)
    # Off by less than half a heading, the step goes along the grid all the same.
    pose, _, _ = drive(FORWARD, (0, 0, 0.3))
    assert pose == pytest.approx([0.5, 0, 0], abs=0.03)


def test_without_the_grid_a_motion_is_seen_from_its_start():
    config = MotionPrimitivesConfig(on_grid=False)
    pose, _, _ = drive(FORWARD, (0, 0, 0.3), config)
    assert pose == pytest.approx([0.5 * np.cos(0.3), 0.5 * np.sin(0.3), 0.3], abs=0.01)
    pose, _, _ = drive(LEFT, (0, 0, 0.3), config)
    assert pose[2] == pytest.approx(0.3 + np.pi / 4, abs=0.025)


@pytest.mark.parametrize("action", [FORWARD, BACK])
def test_a_robot_that_pulls_to_one_side_is_kept_on_the_line(action):
    config = MotionPrimitivesConfig(step=2.0)
    kept, _, _ = drive(action, (0, 0, 0), config, pull=0.05)
    left_alone, _, _ = drive(
        action, (0, 0, 0), MotionPrimitivesConfig(step=2.0, heading_gain=0, line_gain=0), pull=0.05
    )
    # It settles where the gain of the line makes up for the pull: y = pull / (v K_y).
    assert abs(kept[1]) < 0.05 / (CONFIG.speed * CONFIG.line_gain)
    assert abs(left_alone[1]) > 0.2


def test_slip_takes_time_but_no_way():
    pose, motion, slow = drive(FORWARD, (0, 0, 0), slip=0.4)
    _, _, fast = drive(FORWARD, (0, 0, 0))
    assert motion.phase == DONE
    assert pose[0] == pytest.approx(0.5, abs=0.01)
    assert slow > 1.3 * fast


def test_a_robot_that_is_held_up_has_failed():
    _, motion, time = drive(FORWARD, (0, 0, 0), slip=1.0)
    assert motion.phase == FAILED
    assert time == pytest.approx(CONFIG.patience * CONFIG.step / CONFIG.speed + CONFIG.grace, abs=0.05)


def test_the_twist_keeps_its_limits_and_slows_towards_the_end():
    motion = begin_motion(FORWARD, np.zeros(3), 0.0, CONFIG)
    speeds = [motion_twist(motion, np.array([x, 0, 0]), CONFIG)[0] for x in np.linspace(0, 0.49, 50)]
    assert max(speeds) == CONFIG.speed
    assert np.all(np.diff(speeds) <= 0)
    assert speeds[-1] == pytest.approx(np.sqrt(2 * CONFIG.deceleration * 0.01), rel=1e-6)


def test_no_such_motion_and_no_such_value_is_refused():
    with pytest.raises(InputError, match=r"not a motion.*forward"):
        begin_motion(4, np.zeros(3), 0.0, CONFIG)
    with pytest.raises(ConfigError, match=r"motion_primitives\.step"):
        MotionPrimitives(MotionPrimitivesConfig(step=0.0))


class TestSystem:
    @pytest.fixture
    def running(self):
        system = MotionPrimitives()
        simulator = Simulator(system)
        context = simulator.get_mutable_context()
        system.GetInputPort("action").FixValue(context, [-1.0])
        self.move(system, context, 0.0)
        simulator.Initialize()
        return system, simulator, context

    @staticmethod
    def move(system, context, heading):
        X_MB = RigidTransform(RollPitchYaw(0, 0, heading), [0, 0, 0.1])
        system.GetInputPort("X_MB").FixValue(context, Value(X_MB))

    @staticmethod
    def read(system, context, name):
        return system.GetOutputPort(name).Eval(context)

    def test_it_runs_once_for_every_action_and_then_looks_again(self, running):
        system, simulator, context = running
        simulator.AdvanceTo(0.1)
        assert self.read(system, context, "status") == "idle"
        assert self.read(system, context, "motion") == [-1]
        system.GetInputPort("action").FixValue(context, [2.0])
        simulator.AdvanceTo(0.2)
        assert self.read(system, context, "status") == "running"
        assert self.read(system, context, "twist_command") == pytest.approx([0.0, 0.8])
        # The action of the next motion does not touch the one under way.
        system.GetInputPort("action").FixValue(context, [3.0])
        simulator.AdvanceTo(0.3)
        assert self.read(system, context, "motion") == [2]
        self.move(system, context, np.pi / 4)
        seen = []
        while len(seen) < 12:
            simulator.AdvanceTo(context.get_time() + 0.02)
            seen.append((self.read(system, context, "status"), float(self.read(system, context, "motion")[0])))
        assert seen.count(("done", 2.0)) == 1
        assert seen[-1] == ("running", 3.0)

    @pytest.mark.parametrize("action", [np.nan, np.inf, -1.0, 4.0, 0.5])
    def test_what_is_no_action_moves_nothing(self, running, action):
        system, simulator, context = running
        system.GetInputPort("action").FixValue(context, [action])
        simulator.AdvanceTo(0.1)
        assert self.read(system, context, "status") == "idle"
        assert np.all(self.read(system, context, "twist_command") == 0)
