"""What is drawn in Meshcat."""

from .keyframe_display import KeyframeDisplay, KeyframeDisplayConfig, drake_cloud, height_colours

__all__ = ["KeyframeDisplay", "KeyframeDisplayConfig", "drake_cloud", "height_colours"]
