"""Tracks and flippers: from a twist to belt speeds, flipper angles for the ground, and how tracks turn."""

from .crawler_driver import CrawlerDriver, make_crawler_driver
from .flipper_driver import FLIPPERS, FlipperDriver, FlipperDriverConfig
from .flipper_rule import AUTO, FlipperRule, FlipperRuleConfig
from .skid_steer import effective_gauge, quasi_static_twist, slip_offset, turn_rate
from .track_driver import TrackDriver, TrackDriverConfig
from .track_speeds import (
    limit_track_acceleration,
    limit_track_speeds,
    track_speeds_to_twist,
    twist_to_track_speeds,
)

__all__ = [
    "AUTO",
    "FLIPPERS",
    "CrawlerDriver",
    "FlipperDriver",
    "FlipperDriverConfig",
    "FlipperRule",
    "FlipperRuleConfig",
    "TrackDriver",
    "TrackDriverConfig",
    "effective_gauge",
    "limit_track_acceleration",
    "limit_track_speeds",
    "make_crawler_driver",
    "quasi_static_twist",
    "slip_offset",
    "track_speeds_to_twist",
    "turn_rate",
    "twist_to_track_speeds",
]
