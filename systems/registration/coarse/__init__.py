"""Registration without a guess, or with a bad one: the paper's baseline, our search, and descriptors of places."""

from .feature_alignment import FeatureAlignment, FeatureAlignmentConfig, align_features
from .place_descriptor import PlaceDescriptorConfig, describe_place, place_distance
from .search import NearSearchConfig, PoseCandidate, PoseSearchConfig, align_near, find_pose, judge_pose
from .view import View, ViewConfig

__all__ = [
    "FeatureAlignment",
    "FeatureAlignmentConfig",
    "NearSearchConfig",
    "PlaceDescriptorConfig",
    "PoseCandidate",
    "PoseSearchConfig",
    "View",
    "ViewConfig",
    "align_features",
    "align_near",
    "describe_place",
    "find_pose",
    "judge_pose",
    "place_distance",
]
