import numpy as np
import pytest
import umsgpack
from naraha.diagrams.recover import RecoverScenario, make_recover
from naraha.systems.display.snake_display import (
    MODE_COLOURS,
    SnakeDisplay,
    SnakeDisplayConfig,
    errors_in_words,
    force_colour,
)
from naraha.systems.snake.actuator_faults import ActuatorFaultsConfig, ActuatorReport, Fault
from naraha.systems.snake.posture import half_poses, tilt_rotation
from naraha.systems.snake.recovery_motion import RecoveryCommand
from naraha.systems.snake.snake_pilot import MOVES
from naraha.systems.snake.stuck_rules import Diagnosis
from pydrake.geometry import Meshcat
from pydrake.math import RollPitchYaw
from pydrake.systems.analysis import Simulator

from tests.snake.stuck_snake import moving_snake, settled


def test_the_posture_is_that_of_the_simulated_robot_but_for_place_and_yaw():
    _, run = settled(5, 1)
    poses = half_poses(run.read("station.joint_angles"), run.read("station.rpy"), 0.09)
    truth = run.read("station.cheat.body_poses")
    names = [f"{half}{i}" for i in range(10) for half in "FR"]
    plant = run.diagram.GetSubsystemByName("station").GetSubsystemByName("plant")
    true = np.array([truth[int(plant.GetBodyByName(name).index())].translation() for name in names])
    ours = np.array([X.translation() for X in poses])
    np.testing.assert_allclose(
        ours[:, 2] - ours[0, 2], true[:, 2] - true[0, 2], atol=0.04
    )  # its IMU is off by a degree
    np.testing.assert_allclose(
        np.linalg.norm(np.diff(ours, axis=0), axis=1), np.linalg.norm(np.diff(true, axis=0), axis=1), atol=1e-3
    )


def test_tilt_alone_is_roll_and_pitch_without_yaw():
    rpy = np.array([0.2, -0.3, 1.4])
    np.testing.assert_allclose(tilt_rotation(rpy), RollPitchYaw(0.2, -0.3, 0.0).ToRotationMatrix().matrix())


def test_colours_of_forces_and_modes_cannot_be_mistaken():
    assert force_colour(0.0, 30.0).b() > force_colour(30.0, 30.0).b()
    assert force_colour(30.0, 30.0).g() == 0
    assert set(MODE_COLOURS) == set(MOVES)
    colours = {(c.r(), c.g(), c.b()) for c in MODE_COLOURS.values()}
    assert len(colours) == len(MOVES)


def test_errors_are_named_with_their_joints():
    assert errors_in_words(ActuatorReport(("", "hot", ""), (20.0, 90.0, 20.0))) == "y0: hot"
    assert errors_in_words(ActuatorReport()) == ""


@pytest.fixture(scope="module")
def shown():
    meshcat = Meshcat()
    root = moving_snake(3, meshcat)
    simulator = Simulator(root)
    simulator.AdvanceTo(0.5)
    return meshcat


def test_body_pads_ranges_and_margin_are_drawn(shown):
    drawn = ("half/0/body", "half/19/range/0", "half/18/wheel/1", "margin", "target", "stuck", "segment/1")
    for path in (*drawn, *(f"mode/{mode}" for mode in MOVES)):
        assert shown.HasPath(f"snake/{path}"), path


def test_the_colour_of_what_presses_on_a_belly_changes_in_a_recording(read_scene):
    meshcat = Meshcat()
    meshcat.StartRecording(frames_per_second=10.0, set_visualizations_while_recording=False)
    Simulator(moving_snake(3, meshcat)).AdvanceTo(0.5)
    meshcat.PublishRecording()
    scene = read_scene(meshcat)
    assert {f"snake/half/{i}/body/<object>" for i in range(20)} | {"snake/margin/<object>"} == set(scene.turns)
    frames, colours = zip(*scene.turns["snake/margin/<object>"], strict=True)
    assert list(frames) == [0, 1, 2, 3, 4]
    assert all(colour[1] > colour[0] for colour in colours[1:])  # green: it does not tip over
    bellies = [np.array([rgb for _, rgb in scene.turns[f"snake/half/{i}/body/<object>"]]) for i in range(20)]
    pressed = [i for i, rgb in enumerate(bellies) if np.ptp(rgb, axis=0).max() > 0.1]
    assert 0 < len(pressed) < 20


def test_where_it_is_stuck_stays_while_the_wheels_turn_with_the_shape():
    meshcat = Meshcat()
    display = SnakeDisplay(SnakeDisplayConfig(), meshcat, units=4, zones=1)
    simulator = Simulator(display)
    context = simulator.get_mutable_context()
    for name, size in (("joint_angles", 7), ("rpy", 3), ("pad_forces", 16), ("ranges", 24), ("tip_margin", 1)):
        display.GetInputPort(name).FixValue(context, np.zeros(size))
    for name, value in (("recovery_command", RecoveryCommand()), ("actuator_report", ActuatorReport())):
        display.GetInputPort(name).FixValue(context, value)

    def ball(mode, unit):
        display.GetInputPort("mode").FixValue(context, mode)
        display.GetInputPort("diagnosis").FixValue(context, Diagnosis(stuck=True, unit=unit))
        simulator.AdvanceTo(context.get_time() + 0.1)
        return np.array(umsgpack.unpackb(meshcat._GetPackedTransform("snake/stuck"))["matrix"])[12:15]

    driven, recovering, driven_again = ball("wheels", 1), ball("recover", 3), ball("wheels", 3)
    np.testing.assert_allclose(recovering, driven)
    assert driven_again[0] < driven[0] - 0.1


def test_the_mode_is_a_button_in_large_letters(shown):
    assert shown.GetButtonClicks("MODE: WHEELS") == 0
    with pytest.raises(RuntimeError):
        shown.GetButtonClicks("MODE: HOLD")


def test_what_the_cameras_at_head_and_tail_see_is_shown(shown):
    # The picture that is shown at t = 0 is none yet, the first follows a second later.
    assert not shown.HasPath("images/head/0")
    root = moving_snake(3, shown)
    Simulator(root).AdvanceTo(1.05)
    assert shown.HasPath("images/head/0")
    assert shown.HasPath("images/tail/0")


def test_a_fault_is_written_out():
    meshcat = Meshcat()
    scenario = RecoverScenario(
        stuck=1, recording=None, actuators=ActuatorFaultsConfig(faults=[Fault(joint="y8", kind="dead", time=0.2)])
    )
    _, run = make_recover(scenario, meshcat)
    run.advance(0.15)
    assert not meshcat.HasPath("snake/errors/0")
    run.advance(0.3)
    assert meshcat.HasPath("snake/errors/0")
    assert meshcat.GetButtonClicks("y8: dead") == 0


def test_the_configuration_has_the_shipped_robot_in_it():
    assert SnakeDisplayConfig().half_length == pytest.approx(0.09)
