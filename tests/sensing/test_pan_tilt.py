"""The pan-tilt unit: geometry, motion and encoders."""

import gc
import weakref

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.errors import ConfigError, PortError
from naraha.systems.sensing.pan_tilt import PanTilt, PanTiltConfig, pan_tilt_pose, turn
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator

RANGES = {"pan_range_deg": [-60.0, 60.0], "tilt_range_deg": [-30.0, 45.0]}
EXACT = PanTiltConfig(**RANGES, max_rate=1.0, noise=0.0, resolution=1e-9, period=0.02)
angle = st.floats(-3, 3)


# --- geometry -------------------------------------------------------------------------------------------------------


def test_camera_looks_forward_left_and_down():
    forward = {(0.0, 0.0): [1, 0, 0], (np.pi / 2, 0.0): [0, 1, 0], (0.0, np.pi / 2): [0, 0, -1]}
    for angles, axis in forward.items():
        np.testing.assert_allclose(pan_tilt_pose(angles).rotation().matrix()[:, 2], axis, atol=1e-15)
    np.testing.assert_allclose(pan_tilt_pose((0, 0)).rotation().matrix()[:, 0], [0, -1, 0], atol=1e-15)


def test_ray_of_an_image_is_where_pan_and_tilt_point():
    pan, tilt = 0.4, 0.3
    axis = pan_tilt_pose((pan, tilt)).rotation().matrix()[:, 2]
    np.testing.assert_allclose(
        axis, [np.cos(pan) * np.cos(tilt), np.sin(pan) * np.cos(tilt), -np.sin(tilt)], atol=1e-15
    )


def test_camera_off_the_axes_goes_round_them():
    X_HC = RigidTransform([0.1, 0.02, 0.05])
    X_NC = pan_tilt_pose(np.array([np.pi / 2, 0]), X_HC)
    np.testing.assert_allclose(X_NC.translation(), [-0.02, 0.1, 0.05], atol=1e-15)
    expected = RigidTransform(RollPitchYaw(0, 0.3, 0.4), [0, 0, 0]) @ X_HC
    np.testing.assert_allclose(pan_tilt_pose((0.4, 0.3), X_HC).GetAsMatrix4(), expected.GetAsMatrix4(), atol=1e-15)


# --- motion ---------------------------------------------------------------------------------------------------------


@given(start=angle, target=angle, rate=st.floats(0.1, 5), dt=st.floats(0, 2))
def test_an_axis_moves_at_its_rate_and_never_overshoots(start, target, rate, dt):
    after = turn(np.array([start, start]), np.array([target, start]), rate, dt)
    assert after[1] == start
    moved = abs(after[0] - start)
    assert moved == pytest.approx(min(rate * dt, abs(target - start)), abs=1e-12)
    assert min(start, target) - 1e-12 <= after[0] <= max(start, target) + 1e-12


@given(start=angle, target=angle, times=st.lists(st.floats(0, 1), min_size=1, max_size=5))
def test_motion_in_steps_is_motion_at_once(start, target, times):
    stepped = np.array([start, -start])
    for dt in times:
        stepped = turn(stepped, np.array([target, 0.0]), 1.3, dt)
    at_once = turn(np.array([start, -start]), np.array([target, 0.0]), 1.3, sum(times))
    np.testing.assert_allclose(stepped, at_once, atol=1e-12)


class Run:
    """A unit with a fixed command that can be changed."""

    def __init__(self, command, config=EXACT, **options):
        self.system = PanTilt(config, **options)
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        self.command(command)

    def command(self, command):
        self.system.GetInputPort("pan_tilt_command").FixValue(self.context, np.array(command, float))

    def at(self, time, name="cheat.pan_tilt_angles"):
        self.simulator.AdvanceTo(time)
        return self.system.GetOutputPort(name).Eval(self.context)


@pytest.mark.parametrize("time", [0.0, 0.013, 0.1, 0.2, 0.2071, 0.3, 0.5, 1.0])
def test_true_angles_are_exact_at_any_time(time):
    np.testing.assert_allclose(Run([0.5, -0.2]).at(time), [min(time, 0.5), -min(time, 0.2)], atol=1e-12)


def test_true_angles_move_on_between_two_updates():
    run = Run([0.5, -0.2])
    for time in (0.143, 0.147, 0.151):
        np.testing.assert_allclose(run.at(time), [time, -time], atol=1e-12)


def test_axes_stay_where_they_are_when_time_jumps_back():
    run = Run([0.5, -0.2])
    run.at(0.13)
    run.context.SetTime(0.0)
    angles = run.system.GetOutputPort("cheat.pan_tilt_angles").Eval(run.context)
    np.testing.assert_allclose(angles, [0.12, -0.12], atol=1e-12)


def test_new_command_takes_over_from_where_the_axes_are():
    run = Run([0.5, 0.4])
    run.at(0.29)
    run.command([0.0, 0.4])  # taken at 0.30
    np.testing.assert_allclose(run.at(0.35), [0.25, 0.35], atol=1e-12)
    np.testing.assert_allclose(run.at(0.75), [0.0, 0.4], atol=1e-12)


@pytest.mark.parametrize(
    ("command", "reached", "flag"),
    [
        ([2.0, 0.1], [np.pi / 3, 0.1], 1),
        ([-2.0, -2.0], [-np.pi / 3, -np.pi / 6], 1),
        ([0.1, np.pi / 4 + 0.01], [0.1, np.pi / 4], 1),
        ([np.pi / 3, np.pi / 4], [np.pi / 3, np.pi / 4], 0),
        ([0.1, 0.1], [0.1, 0.1], 0),
    ],
)
def test_command_outside_the_range_is_cut_to_it_and_reported(command, reached, flag):
    run = Run(command)
    assert run.at(0.01, "out_of_range")[0] == flag
    np.testing.assert_allclose(run.at(2.0), reached, atol=1e-12)
    assert run.at(2.0, "out_of_range")[0] == flag
    run.command([0, 0])
    assert run.at(2.05, "out_of_range")[0] == 0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_command_that_is_not_finite_holds_the_position(bad):
    run = Run([0.5, 0.5])
    run.at(0.19)
    run.command([bad, 0.5])  # taken at 0.20; the other axis goes on
    np.testing.assert_allclose(run.at(0.4), [0.2, 0.4], atol=1e-12)
    assert run.at(0.4, "out_of_range")[0] == 1
    run.command([0.5, 0.5])
    np.testing.assert_allclose(run.at(1.0), [0.5, 0.5], atol=1e-12)
    assert run.at(1.0, "out_of_range")[0] == 0


# --- encoders -------------------------------------------------------------------------------------------------------


def test_encoders_read_at_every_period_and_hold_between():
    run = Run([0.5, -0.2])
    np.testing.assert_allclose(run.at(0.119, "pan_tilt_angles"), [0.1, -0.1], atol=1e-8)
    np.testing.assert_allclose(run.at(0.121, "pan_tilt_angles"), [0.12, -0.12], atol=1e-8)


def test_readings_are_whole_steps_near_the_truth():
    run = Run([0.5, -0.2], PanTiltConfig(**RANGES, noise=0.0, resolution=0.003))
    for time in (0.11, 0.21, 0.33):
        reading = run.at(time, "pan_tilt_angles")
        np.testing.assert_allclose(reading / 0.003, np.rint(reading / 0.003), atol=1e-9)
        truth = np.array([1, -1]) * min(np.floor(time / 0.02 + 1e-9) * 0.02, 1)
        assert np.all(np.abs(reading - np.clip(truth, -0.2, 0.5)) <= 0.0015 + 1e-9)


def test_readings_have_their_noise():
    run = Run([0.0, 0.0], PanTiltConfig(**RANGES, noise=0.01, resolution=1e-6))
    readings = np.array([run.at(0.02 * k + 0.01, "pan_tilt_angles").copy() for k in range(800)])
    assert readings.std() == pytest.approx(0.01, rel=0.1)
    assert abs(readings.mean()) < 4 * 0.01 / 40
    assert abs(np.corrcoef(readings.T)[0, 1]) < 0.15


def test_one_seed_gives_one_reading_and_another_seed_another():
    a, b, c = (Run([0.3, 0.1], PanTiltConfig(), seed=s).at(0.11, "pan_tilt_angles") for s in (5, 5, 6))
    np.testing.assert_array_equal(a, b)
    assert np.any(a != c)


def test_cloned_context_continues_like_the_original():
    run = Run([0.5, 0.3], PanTiltConfig())
    before = run.at(0.1, "pan_tilt_angles").copy()
    clone = Simulator(run.system, run.context.Clone())
    clone.AdvanceTo(0.4)
    np.testing.assert_array_equal(run.system.GetOutputPort("pan_tilt_angles").Eval(run.context), before)
    for name in ("pan_tilt_angles", "cheat.pan_tilt_angles"):
        np.testing.assert_array_equal(run.system.GetOutputPort(name).Eval(clone.get_context()), run.at(0.4, name))


# --- start, and what a user can get wrong ---------------------------------------------------------------------------


def test_it_starts_where_it_is_told_or_as_near_to_zero_as_it_can():
    start = np.array([0.2, -0.1])
    told = PanTilt(EXACT, angles=start)
    high = PanTilt(PanTiltConfig(pan_range_deg=[10.0, 20.0], tilt_range_deg=[-20.0, -10.0], resolution=1e-9))
    for system, expected in ((told, start), (high, np.deg2rad([10, -10]))):
        context = system.CreateDefaultContext()
        for name in ("pan_tilt_angles", "cheat.pan_tilt_angles"):
            np.testing.assert_allclose(system.GetOutputPort(name).Eval(context), expected, atol=1e-8)
        assert system.GetOutputPort("out_of_range").Eval(context)[0] == 0


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (PanTiltConfig(pan_range_deg=[10.0, -10.0]), "pan-tilt: pan_range_deg: range"),
        (PanTiltConfig(tilt_range_deg=[5.0, 5.0]), "pan-tilt: tilt_range_deg: range"),
        (PanTiltConfig(tilt_range_deg=[5.0]), "pan-tilt: tilt_range_deg: range"),
        (PanTiltConfig(tilt_range_deg=[-5.0, 95.0]), "pan-tilt: tilt_range_deg: out of range"),
        (PanTiltConfig(pan_range_deg=[np.nan, 5.0]), "pan-tilt: pan_range_deg: out of range"),
        (PanTiltConfig(max_rate=0.0), "pan-tilt: max_rate"),
        (PanTiltConfig(resolution=0.0), "pan-tilt: resolution"),
    ],
)
def test_configuration_out_of_range_is_refused(config, message):
    with pytest.raises(ConfigError, match=message):
        PanTilt(config)


@pytest.mark.parametrize("angles", [[2.0, 0.0], [0.0, -1.0], [np.nan, 0.0]])
def test_start_outside_the_ranges_is_refused(angles):
    with pytest.raises(ConfigError, match=r"pan-tilt: start out of range .*tilt \[-30.0, 45.0\] deg"):
        PanTilt(EXACT, angles=np.array(angles))


def test_missing_connection_is_named():
    with pytest.raises(PortError, match=r"PanTilt\.pan_tilt_command"):
        Simulator(PanTilt()).AdvanceTo(0.1)


def test_it_is_freed_when_nothing_uses_it():
    system = PanTilt()
    system.CreateDefaultContext()
    gone = weakref.ref(system)
    del system
    gc.collect()
    assert gone() is None
