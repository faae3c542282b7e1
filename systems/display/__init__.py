"""What is drawn in Meshcat."""

from .colours import DOSE_RATE, HEIGHT, INTENSITY, NIR, TEMPERATURE, ColourScale, for_meshcat, height_colours
from .keyframe_display import KeyframeDisplay, KeyframeDisplayConfig, drake_cloud
from .map_display import draw_attribute, draw_classes, draw_dose, draw_regions, draw_source
from .semantic_display import (
    POINT_LAYERS,
    SemanticDisplay,
    SemanticDisplayConfig,
    draw_keyframe,
    draw_last_keyframe,
    layer_path,
)

__all__ = [
    "DOSE_RATE",
    "HEIGHT",
    "INTENSITY",
    "NIR",
    "POINT_LAYERS",
    "TEMPERATURE",
    "ColourScale",
    "KeyframeDisplay",
    "KeyframeDisplayConfig",
    "SemanticDisplay",
    "SemanticDisplayConfig",
    "drake_cloud",
    "draw_attribute",
    "draw_classes",
    "draw_dose",
    "draw_keyframe",
    "draw_last_keyframe",
    "draw_regions",
    "draw_source",
    "for_meshcat",
    "height_colours",
    "layer_path",
]
