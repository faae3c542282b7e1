"""Tracks, wheels and flippers: from a twist to their speeds, flipper angles for the ground, and how tracks turn."""

from .crawler_driver import CrawlerDriver, make_crawler_driver
from .differential_driver import DifferentialDriver, make_differential_driver
from .flipper_driver import FLIPPERS, FlipperDriver, FlipperDriverConfig
from .flipper_rule import AUTO, FlipperRule, FlipperRuleConfig
from .mode_switch import MODES, ModeSwitch, ModeSwitchConfig
from .motion_primitives import PRIMITIVES, MotionPrimitives, MotionPrimitivesConfig
from .skid_steer import effective_gauge, quasi_static_twist, slip_offset, turn_rate
from .tilt_unit import TiltConfig, TiltEncoder, TiltSweep
from .track_driver import TrackDriver, TrackDriverConfig
from .track_speeds import (
    limit_track_acceleration,
    limit_track_speeds,
    track_speeds_to_twist,
    twist_to_track_speeds,
)
from .tracked_driver import TrackedDriver, make_tracked_driver
from .wheel_driver import WheelDriver, WheelDriverConfig

__all__ = [
    "AUTO",
    "FLIPPERS",
    "MODES",
    "PRIMITIVES",
    "CrawlerDriver",
    "DifferentialDriver",
    "FlipperDriver",
    "FlipperDriverConfig",
    "FlipperRule",
    "FlipperRuleConfig",
    "ModeSwitch",
    "ModeSwitchConfig",
    "MotionPrimitives",
    "MotionPrimitivesConfig",
    "TiltConfig",
    "TiltEncoder",
    "TiltSweep",
    "TrackDriver",
    "TrackDriverConfig",
    "TrackedDriver",
    "WheelDriver",
    "WheelDriverConfig",
    "effective_gauge",
    "limit_track_acceleration",
    "limit_track_speeds",
    "make_crawler_driver",
    "make_differential_driver",
    "make_tracked_driver",
    "quasi_static_twist",
    "slip_offset",
    "track_speeds_to_twist",
    "turn_rate",
    "twist_to_track_speeds",
]
