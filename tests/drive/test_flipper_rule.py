import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naraha.systems.drive import FlipperRule, FlipperRuleConfig
from naraha.systems.drive.flipper_rule import preset_for_pitch
from naraha.systems.errors import ConfigError, PortError
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator

CONFIG = FlipperRuleConfig(period=0.02, slope_enter=0.2, slope_exit=0.1, confirm_time=0.3)
UP, DOWN = -0.4, 0.4  # pitch of a raised and of a lowered nose


class Run:
    """A rule whose inputs are set by hand."""

    def __init__(self, config=CONFIG, *, pitch=0.0, preset=None):
        self.system = FlipperRule(config)
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        if pitch is not None:
            self.pitch(pitch)
        if preset is not None:
            self.preset(preset)

    def pitch(self, pitch):
        self.system.GetInputPort("rpy").FixValue(self.context, np.array([0.3, pitch, 1.0]))

    def preset(self, name):
        self.system.GetInputPort("flipper_preset").FixValue(self.context, Value(name))

    def after(self, seconds):
        self.simulator.AdvanceTo(self.context.get_time() + seconds)
        return self.system.GetOutputPort("active_preset").Eval(self.context)

    def angles(self):
        return self.system.GetOutputPort("flipper_command").Eval(self.context)


def test_level_ground_means_flat():
    run = Run()
    assert run.after(5.0) == "flat"
    np.testing.assert_array_equal(run.angles(), CONFIG.flipper_presets["flat"])


@pytest.mark.parametrize(("pitch", "expected"), [(UP, "climb"), (DOWN, "descend")])
def test_a_lasting_slope_brings_its_preset_after_the_confirm_time_and_not_before(pitch, expected):
    run = Run()
    run.after(1.01)
    run.pitch(pitch)
    assert run.after(0.29) == "flat"
    assert run.after(0.04) == expected
    np.testing.assert_array_equal(run.angles(), CONFIG.flipper_presets[expected])
    run.pitch(0.0)
    assert run.after(0.29) == expected
    assert run.after(0.04) == "flat"


def test_bumps_shorter_than_the_confirm_time_change_nothing():
    run = Run()
    seen = set()
    for _ in range(10):
        run.pitch(UP)
        seen.add(run.after(0.26))
        run.pitch(0.0)
        seen.add(run.after(0.06))
        run.pitch(DOWN)
        seen.add(run.after(0.26))
        run.pitch(0.0)
        seen.add(run.after(0.06))
    assert seen == {"flat"}


def test_it_goes_from_climb_to_descend_over_a_crest():
    run = Run(pitch=UP)
    assert run.after(1.0) == "climb"
    run.pitch(DOWN)
    assert run.after(0.2) == "climb"
    assert run.after(0.2) == "descend"


def test_a_pitch_between_exit_and_enter_keeps_what_is_active():
    run = Run(pitch=-0.15)
    assert run.after(2.0) == "flat"
    run.pitch(UP)
    assert run.after(1.0) == "climb"
    run.pitch(-0.15)
    assert run.after(2.0) == "climb"


def test_a_commanded_preset_is_taken_at_once_whatever_the_pitch():
    run = Run(pitch=DOWN, preset="climb")
    assert run.after(0.01) == "climb"
    assert run.after(5.0) == "climb"


def test_a_commanded_preset_needs_no_attitude():
    assert Run(pitch=None, preset="descend").after(1.0) == "descend"


def test_auto_on_the_stair_keeps_the_preset_that_was_commanded_before_it():
    run = Run(pitch=-0.15, preset="climb")  # between exit and enter: flat would stay flat here
    run.after(0.5)
    run.preset("auto")
    assert run.after(2.0) == "climb"
    run.pitch(0.0)
    assert run.after(1.0) == "flat"


def test_further_presets_can_be_commanded_and_auto_leaves_them():
    config = FlipperRuleConfig(flipper_presets=FlipperRuleConfig().flipper_presets | {"stow": [1.5, 1.4, 1.3, 1.2]})
    run = Run(config, preset="stow")
    assert run.after(0.1) == "stow"
    np.testing.assert_array_equal(run.angles(), [1.5, 1.4, 1.3, 1.2])
    run.preset("auto")
    assert run.after(1.0) == "flat"


def test_a_pitch_that_is_not_finite_changes_nothing():
    run = Run(pitch=UP)
    assert run.after(1.0) == "climb"
    run.pitch(math.nan)
    assert run.after(1.0) == "climb"


def test_an_unknown_preset_names_the_valid_ones():
    with pytest.raises(PortError, match=r"flipper_preset.*'fly'.*auto, flat, climb, descend"):
        Run(preset="fly").after(0.1)


def test_auto_without_attitude_is_an_error():
    with pytest.raises(PortError, match="rpy"):
        Run(pitch=None).after(0.1)


@given(active=st.sampled_from(["flat", "climb", "descend"]), pitch=st.floats(-1, 1))
def test_nose_up_and_nose_down_are_mirror_images(active, pitch):
    mirror = {"flat": "flat", "climb": "descend", "descend": "climb"}
    assert preset_for_pitch(mirror[active], -pitch, 0.2, 0.1) == mirror[preset_for_pitch(active, pitch, 0.2, 0.1)]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"slope_exit": 0.3, "slope_enter": 0.2}, "slope_exit.*<= 0.2 rad"),
        ({"flipper_presets": {"flat": [0.0] * 4, "climb": [0.0] * 4}}, "flipper_presets.*descend"),
        ({"flipper_presets": FlipperRuleConfig().flipper_presets | {"flat": [0.0] * 3}}, "flipper_presets.flat"),
        ({"flipper_presets": FlipperRuleConfig().flipper_presets | {"climb": [0.0, 0, 0, math.nan]}}, "climb"),
        ({"flipper_presets": FlipperRuleConfig().flipper_presets | {"auto": [0.0] * 4}}, "auto"),
        ({"confirm_time": -1.0}, "confirm_time"),
    ],
)
def test_bad_configurations_are_refused(options, words):
    with pytest.raises(ConfigError, match=words):
        FlipperRule(FlipperRuleConfig(**options))
