"""Views from a handful of places metres apart, joined without odometry (S0-d)."""

from .place_search import PlaceCandidate, PlaceSearchConfig, find_pose
from .viewpoint_merger import ViewpointMerger, ViewpointMergerConfig
from .viewpoint_set import MergeConfig, MergeResult, merge_viewpoints

__all__ = [
    "MergeConfig",
    "MergeResult",
    "PlaceCandidate",
    "PlaceSearchConfig",
    "ViewpointMerger",
    "ViewpointMergerConfig",
    "find_pose",
    "merge_viewpoints",
]
