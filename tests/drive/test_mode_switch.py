import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.drive.mode_switch import MODES, ModeSwitch, ModeSwitchConfig, decide
from naraha.systems.errors import ConfigError, PortError
from pydrake.common.value import AbstractValue

AUTONOMOUS, OPERATOR = np.array([0.2, 0.1]), np.array([-0.1, 0.4])


class Switch:
    """The system with inputs that can be changed at any instant."""

    def __init__(self, command="stop", autonomous=AUTONOMOUS, operator=OPERATOR, stamp=0.0, **config):
        self.system = ModeSwitch(ModeSwitchConfig(**config))
        self.context = self.system.CreateDefaultContext()
        self.fix("mode_command", AbstractValue.Make(command))
        self.fix("autonomous_twist", autonomous)
        self.fix("teleoperation_twist", operator)
        self.fix("teleoperation_time", [stamp])

    def fix(self, name, value):
        self.system.GetInputPort(name).FixValue(self.context, value)

    def at(self, time):
        self.context.SetTime(time)
        twist, mode, reason = (
            self.system.GetOutputPort(name).Eval(self.context) for name in ("twist_command", "mode", "reason")
        )
        return np.array(twist), mode, reason


@pytest.mark.parametrize(
    ("command", "twist"), [("stop", [0, 0]), ("autonomous", AUTONOMOUS), ("teleoperation", OPERATOR)]
)
def test_the_twist_is_that_of_the_mode(command, twist):
    got, mode, reason = Switch(command).at(0.1)
    np.testing.assert_array_equal(got, twist)
    assert (mode, reason) == (command, "")


def test_a_command_counts_at_once_without_time_going_on():
    switch = Switch("autonomous")
    assert switch.at(1.0)[1] == "autonomous"
    for command in ("stop", "autonomous"):
        switch.fix("mode_command", AbstractValue.Make(command))
        assert switch.at(1.0)[1] == command
    switch.fix("teleoperation_time", [1.0])
    switch.fix("mode_command", AbstractValue.Make("teleoperation"))
    np.testing.assert_array_equal(switch.at(1.0)[0], OPERATOR)


def test_a_lost_link_stops_the_robot_until_input_comes_again():
    switch = Switch("teleoperation", stamp=2.0, link_timeout=0.5)
    assert switch.at(2.5)[1] == "teleoperation"
    twist, mode, reason = switch.at(2.51)
    np.testing.assert_array_equal(twist, 0)
    assert mode == "stop"
    assert reason == "tele-operation input lost for 0.51 s"
    switch.fix("teleoperation_time", [2.5])
    np.testing.assert_array_equal(switch.at(2.51)[0], OPERATOR)


def test_autonomous_driving_needs_no_link_and_no_operator():
    switch = Switch("autonomous", stamp=np.nan, operator=[np.nan, np.nan])
    np.testing.assert_array_equal(switch.at(100.0)[0], AUTONOMOUS)


@pytest.mark.parametrize("stamp", [np.nan, -np.inf, np.inf])
def test_without_any_operator_input_tele_operation_stands_still(stamp):
    twist, mode, reason = Switch("teleoperation", stamp=stamp).at(0.0)
    np.testing.assert_array_equal(twist, 0)
    assert (mode, reason) == ("stop", "no tele-operation input yet")


def test_a_stamp_from_the_future_does_not_outlive_the_link():
    twist, _, reason = Switch("teleoperation", stamp=100.0).at(1.0)
    np.testing.assert_array_equal(twist, 0)
    assert reason == "tele-operation stamp 99.00 s ahead of the clock"


def test_an_unknown_mode_stops_and_names_the_valid_ones():
    twist, mode, reason = Switch("automatic").at(0.0)
    np.testing.assert_array_equal(twist, 0)
    assert mode == "stop"
    assert all(valid in reason for valid in MODES)


@pytest.mark.parametrize("bad", [[np.nan, 0], [0, np.inf], [-np.inf, 0]])
@pytest.mark.parametrize("command", ["autonomous", "teleoperation"])
def test_a_twist_that_is_not_finite_stops(command, bad):
    twist, mode, reason = Switch(command, autonomous=bad, operator=bad).at(0.0)
    np.testing.assert_array_equal(twist, 0)
    assert (mode, reason) == ("stop", f"{command} twist is not finite")


@given(v=st.floats(-10, 10), omega=st.floats(-10, 10))
def test_limits_hold_and_the_curvature_is_kept(v, omega):
    config = ModeSwitchConfig(max_speed=0.3, max_yaw_rate=0.8)
    got = np.array(decide("teleoperation", np.zeros(2), np.array([v, omega]), 0.0, config).twist)
    assert (np.abs(got) <= np.array([0.3, 0.8]) * (1 + 1e-12)).all()
    assert got[0] * omega == pytest.approx(got[1] * v, abs=1e-9)
    if abs(v) <= 0.3 and abs(omega) <= 0.8:
        np.testing.assert_array_equal(got, [v, omega])


@given(
    command=st.text(max_size=15) | st.sampled_from(MODES),
    twist=st.tuples(st.floats(), st.floats()),
    age=st.floats(),
)
def test_whatever_comes_in_the_twist_is_finite_and_a_stop_has_a_reason(command, twist, age):
    decision = decide(command, np.array(twist), np.array(twist), age, ModeSwitchConfig())
    assert np.isfinite(decision.twist).all()
    assert decision.mode in ("stop", command)
    assert (decision.reason == "") == (decision.mode == command)
    if decision.mode == "stop":
        assert decision.twist == (0.0, 0.0)


def test_bad_config_and_bad_types_are_refused():
    with pytest.raises(ConfigError, match=r"mode_switch\.link_timeout"):
        ModeSwitch(ModeSwitchConfig(link_timeout=0))
    system = ModeSwitch()
    with pytest.raises(PortError, match="mode_command"):
        system.GetOutputPort("mode").Eval(system.CreateDefaultContext())
