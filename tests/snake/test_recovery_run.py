import itertools

import numpy as np
import pytest
from naraha.models.snake.snake_model import SnakeModel
from naraha.systems.errors import ConfigError
from naraha.systems.snake import (
    ChainKinematics,
    NullSpaceConfig,
    RecoveryCommand,
    idle_run,
    middle_in_head,
    plan_motion,
    preset,
    start_run,
    step_run,
)

from tests.snake.robot import snake_body

MODEL = SnakeModel()
BODY = snake_body(MODEL)
L = MODEL.half_length
STRAIGHT = np.zeros(19)


def wavy(seed, size=0.3):
    return size * np.random.default_rng(seed).standard_normal(19)


def towards(angles, offset=(0.09, 0.0, 0.15), first=3, last=7, **options):
    target = middle_in_head(angles, first, last, L) + offset
    return RecoveryCommand(1, True, first, last, tuple(target), **options)


def recover(angles, command=None, config=None, *, follow=0.5, dead=(), margin=np.inf, broken=None):
    """Runs a recovery with joints that follow their commands by a share each tick; returns all runs."""
    config = config or NullSpaceConfig()
    runs = [start_run(idle_run(BODY), command or towards(angles), angles, BODY, config)]
    measured = angles.copy()
    while runs[-1].status.phase in ("moving", "settling") and len(runs) < 3000:
        seen = measured.copy()
        if broken is not None and len(runs) > 50:
            seen[broken] = np.nan
        runs.append(step_run(runs[-1], seen, margin, BODY, config))
        step = follow * (np.nan_to_num(runs[-1].joints) - measured)
        step[list(dead)] = 0.0
        measured = measured + step
    return runs


def largest_error(runs):
    return max(np.linalg.norm(run.status.control_error[:3]) for run in runs)


def test_the_control_point_goes_to_the_next_pitch_joint_by_way_of_the_yaw_joint():
    angles = wavy(0)
    motion = plan_motion(angles, towards(angles), L)
    chain = ChainKinematics(13, L)
    joints = chain.positions(angles[6:])
    np.testing.assert_allclose(motion.position[[0, 50, 100]], joints[[8, 7, 6]], atol=1e-9)
    for end, joint in ((0, 9), (100, 7)):
        R = ChainKinematics(joint, L).control_pose(angles[6 : 6 + joint])[0]
        np.testing.assert_allclose(motion.rotation[end], R, atol=1e-4)


def test_the_trailing_body_stays_on_the_line_on_which_it_lay():
    angles = wavy(1)
    motion = plan_motion(angles, towards(angles), L)
    line = ChainKinematics(13, L).positions(angles[6:])
    dense = np.vstack([a + np.linspace(0, 1, 50)[:, None] * (b - a) for a, b in itertools.pairwise(line)])
    for i in (0, 30, 50, 80, 100):
        tail = ChainKinematics(len(motion.trailing[i]), L, starts_with_yaw=True).positions(motion.trailing[i])
        first = motion.position[i] - L * motion.rotation[i][:, 0]
        axles = (first + tail @ motion.rotation[i].T)[1::2]
        assert max(np.linalg.norm(dense - axle, axis=1).min() for axle in axles) < 0.02
    np.testing.assert_allclose(motion.trailing[0], angles[15:], atol=1e-4)
    np.testing.assert_allclose(motion.trailing[-1], angles[13:-2], atol=1e-4)


def test_the_twist_is_the_derivative_of_the_way():
    angles = wavy(2)
    motion = plan_motion(angles, towards(angles), L)
    a, b = motion.reference(0.3, 1.0), motion.reference(0.3 + 1e-6, 1.0)
    np.testing.assert_allclose((b - a)[:3] / 1e-6, a[12:15], atol=1e-6)
    spin = (b - a)[3:12].reshape(3, 3) / 1e-6 @ a[3:12].reshape(3, 3).T
    np.testing.assert_allclose([spin[2, 1], spin[0, 2], spin[1, 0]], a[15:], atol=1e-5)


def test_the_target_is_turned_from_the_head_into_the_segment():
    angles = wavy(3)
    command = towards(angles, offset=(0, 0, 0))
    motion = plan_motion(angles, command, L)
    np.testing.assert_allclose(motion.target, ChainKinematics(9, L).positions(angles[6:15])[4], atol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_the_control_point_keeps_to_its_way_and_arrives(seed):
    runs = recover(wavy(seed))
    assert runs[-1].status.phase == "done", runs[-1].status.reason
    assert largest_error(runs) < 2e-3
    assert min(run.status.joint_margin for run in runs[1:]) > 0


@pytest.mark.parametrize(("first", "last"), [(0, 4), (3, 6), (3, 7), (2, 8), (5, 9)])
def test_a_straight_body_is_bent_towards_the_target(first, last):
    runs = recover(STRAIGHT, towards(STRAIGHT, first=first, last=last))
    assert runs[-1].status.phase == "done", runs[-1].status.reason
    assert runs[-1].status.distance < 0.8 * runs[1].status.distance
    assert largest_error(runs) < 5e-3


def test_joints_in_front_of_the_segment_and_their_wheels_hold():
    angles = wavy(4)
    for run in recover(angles):
        np.testing.assert_array_equal(run.joints[:6], angles[:6])
        np.testing.assert_array_equal(run.wheels[:4], 0.0)


def test_the_wheels_behind_roll_up_by_one_unit():
    runs = recover(STRAIGHT)
    rolled = sum(run.wheels for run in runs) * NullSpaceConfig().period * MODEL.wheel_radius
    np.testing.assert_allclose(rolled[8:], 2 * L, atol=2e-3)


def test_without_the_null_space_a_straight_body_does_not_move():
    runs = recover(STRAIGHT, config=NullSpaceConfig(alpha=0.0))
    assert runs[-1].status.phase == "stopped"
    assert "from its place" in runs[-1].status.reason


def test_the_law_of_the_paper_says_that_a_straight_pose_is_singular():
    status = recover(STRAIGHT, config=preset("paper"))[-1].status
    assert (status.phase, "singular" in status.reason) == ("stopped", True)


def test_a_start_beyond_the_range_comes_back_into_it():
    angles = STRAIGHT.copy()
    angles[8], angles[9] = 1.62, 1.35
    runs = recover(angles)
    assert runs[1].status.joint_margin < 0
    assert runs[-1].status.phase == "done", runs[-1].status.reason
    assert runs[-1].status.joint_margin > 0


def test_a_target_out_of_reach_is_approached_and_the_answer_says_so():
    status = recover(STRAIGHT, towards(STRAIGHT, offset=(0.0, 0.0, 2.0)))[-1].status
    assert status.phase == "done"
    assert "out of reach" in status.reason


@pytest.mark.parametrize("joint", [6, 8, 10, 17])
def test_a_dead_actuator_stops_the_recovery_and_is_named(joint):
    angles = wavy(5)
    status = recover(angles, dead=[joint])[-1].status
    assert status.phase == "stopped", status.reason
    assert f"{'py'[joint % 2]}{joint // 2}" in status.reason


def test_a_missing_angle_stops_the_recovery_and_is_named():
    runs = recover(STRAIGHT, broken=9)
    assert runs[-1].status.phase == "stopped"
    assert "y4" in runs[-1].status.reason
    assert all(np.isfinite(run.joints).all() for run in runs)


def test_it_refuses_to_tip_over():
    runs = recover(STRAIGHT, margin=0.005)
    assert runs[-1].status.phase == "stopped"
    assert "tip over" in runs[-1].status.reason
    np.testing.assert_allclose(runs[-1].joints, STRAIGHT, atol=1e-9)


def test_near_tipping_it_goes_slower():
    assert len(recover(STRAIGHT, margin=0.02)) > 1.3 * len(recover(STRAIGHT))


def test_a_motion_that_would_be_too_fast_takes_longer():
    run = start_run(idle_run(BODY), towards(STRAIGHT, duration=0.1), STRAIGHT, BODY, NullSpaceConfig())
    assert run.duration > 1.5


def test_stop_ends_it_where_it_is():
    config = NullSpaceConfig()
    run = start_run(idle_run(BODY), towards(STRAIGHT), STRAIGHT, BODY, config)
    for _ in range(100):
        run = step_run(run, np.nan_to_num(run.joints), np.inf, BODY, config)
    stopped = start_run(run, RecoveryCommand(2, False), run.joints, BODY, config)
    assert stopped.status.phase == "stopped"
    np.testing.assert_array_equal(stopped.joints, run.joints)
    np.testing.assert_array_equal(stopped.wheels, 0.0)


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (RecoveryCommand(1, True, 7, 12), "outside the body"),
        (RecoveryCommand(1, True, -1, 5), "outside the body"),
        (RecoveryCommand(1, True, 7, 3), "not behind the reference"),
        (RecoveryCommand(1, True, 3, 5), "too short"),
        (RecoveryCommand(1, True, 3, 7, (0.0, np.nan, 0.0)), "target"),
        (RecoveryCommand(1, True, 3, 7, duration=-1.0), "duration"),
    ],
)
def test_what_cannot_be_done_is_refused_with_the_reason(command, words):
    run = start_run(idle_run(BODY), command, STRAIGHT, BODY, NullSpaceConfig())
    assert run.status.phase == "refused"
    assert words in run.status.reason
    with pytest.raises(ConfigError, match=words):
        plan_motion(STRAIGHT, command, L)


def test_joints_without_angles_at_the_start_are_refused():
    angles = STRAIGHT.copy()
    angles[4] = np.nan
    status = start_run(idle_run(BODY), RecoveryCommand(1, True, 3, 7), angles, BODY, NullSpaceConfig()).status
    assert (status.phase, "p2" in status.reason) == ("refused", True)


def test_the_manipulability_term_leads_out_of_a_straight_pose_that_the_target_leaves_straight():
    angles = 0.005 * np.random.default_rng([0, 1]).standard_normal(19)
    command = towards(angles, offset=(L, 0.0, 0.0))
    errors = {
        weight: largest_error(recover(angles, command, NullSpaceConfig(singular_weight=weight)))
        for weight in (NullSpaceConfig().singular_weight, 0.0)
    }
    with_term, without = errors.values()
    assert with_term < 2e-3
    assert without > 1.5 * with_term


def test_the_joint_term_keeps_joints_in_their_range_where_nothing_else_does():
    angles = np.zeros(19)
    angles[9] = BODY.joint_limits[9] - np.deg2rad(4)
    command = towards(angles, offset=(L, 0.12, 0.2))
    margins = [
        min(run.status.joint_margin for run in recover(angles, command, NullSpaceConfig(**changes))[1:])
        for changes in ({"bounded": False}, {"bounded": False, "joint_weight": 0.0})
    ]
    assert margins[0] > np.deg2rad(3)
    assert margins[1] < 0


def on_a_stone(free_after=0.3):
    """Runs a recovery of a straight body that sags around a stone; drives give way by what the weight takes of them.

    After so many seconds the stone no longer presses, and the drives that gave way to it are back at their commands.
    """
    config = NullSpaceConfig()
    weight = np.zeros(19)
    weight[[6, 8, 10]] = -0.008, -0.016, -0.003
    measured = STRAIGHT + weight
    command = towards(measured, first=2, last=6)
    runs = [start_run(idle_run(BODY), command, measured, BODY, config, held=STRAIGHT)]
    while runs[-1].status.phase in ("moving", "settling") and len(runs) < 3000:
        runs.append(step_run(runs[-1], measured, np.inf, BODY, config))
        lifted = min(len(runs) * config.period / free_after, 1.0)
        measured = runs[-1].joints + (1.0 - lifted) * weight
    return runs


def test_a_body_that_sags_is_not_let_go_when_it_starts_to_move():
    runs = on_a_stone()
    # Its drives are told what held it, not where it sagged to; and so nothing gives way.
    np.testing.assert_array_equal(runs[0].joints, STRAIGHT)
    assert np.abs(runs[1].joints).max() < 2e-3
    assert runs[-1].status.phase == "done"


@pytest.mark.parametrize("free_after", [0.15, 0.3, 0.7])
def test_the_reference_starts_where_the_control_point_is_and_leaves_the_sag_behind_as_the_load_goes(free_after):
    runs = on_a_stone(free_after)
    assert np.linalg.norm(runs[0].sag[:3]) > 0.005  # the control point hangs that much below
    assert np.linalg.norm(runs[1].status.control_error[:3]) < 1e-5
    assert largest_error(runs) < 0.0015
    after = next(run for run in runs if run.elapsed > free_after + 0.05)
    motion = plan_motion(STRAIGHT, runs[0].command, L)
    place = motion.reference(after.status.progress, 0.0)[:12]
    np.testing.assert_allclose(after.status.reference, place, atol=1e-6)


def test_a_load_that_stays_does_not_keep_the_control_point_from_its_place():
    runs = on_a_stone(free_after=1e6)
    assert runs[-1].status.phase == "done", runs[-1].status.reason
    end = runs[-1].status
    place = plan_motion(STRAIGHT, runs[0].command, L).position[-1]
    assert np.linalg.norm(end.reference[:3] + end.control_error[:3] - place) < 1e-3
    assert largest_error(runs) < 0.0015


def test_the_null_space_term_comes_in_gently():
    def first_step(start_time):
        runs = recover(wavy(2), config=NullSpaceConfig(start_time=start_time))
        return max(np.abs(b.joints - a.joints).max() for a, b in itertools.pairwise(runs[1:6]))

    assert first_step(0.3) < 0.2 * first_step(1e-3)


def test_what_presses_sideways_is_let_go_at_the_start():
    held = STRAIGHT.copy()
    held[7] = 0.4  # a bend that walls do not let the snake have
    held[8] = 0.4  # more than any weight asks for
    run = start_run(idle_run(BODY), towards(STRAIGHT), STRAIGHT, BODY, NullSpaceConfig(), held=held)
    assert run.joints[7] == 0.0
    assert run.joints[8] == pytest.approx(0.5 * NullSpaceConfig().max_lead)


def test_a_joint_whose_held_command_is_missing_starts_where_it_is():
    held = np.full(19, np.nan)
    run = start_run(idle_run(BODY), towards(wavy(3)), wavy(3), BODY, NullSpaceConfig(), held=held)
    np.testing.assert_array_equal(run.joints, wavy(3))
