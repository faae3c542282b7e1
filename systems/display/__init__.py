"""What is drawn in Meshcat."""

from .colours import DOSE_RATE, HEIGHT, INTENSITY, NIR, TEMPERATURE, ColourScale, for_meshcat, height_colours
from .keyframe_display import KeyframeDisplay, KeyframeDisplayConfig, drake_cloud
from .map_display import draw_attribute, draw_classes, draw_dose, draw_regions, draw_source
from .route_display import ROUTE_COLOURS, RouteDisplay, RouteDisplayConfig, draw_routes
from .semantic_display import (
    POINT_LAYERS,
    SemanticDisplay,
    SemanticDisplayConfig,
    draw_keyframe,
    draw_last_keyframe,
    layer_path,
)
from .snake_display import SnakeDisplay, SnakeDisplayConfig

__all__ = [
    "DOSE_RATE",
    "HEIGHT",
    "INTENSITY",
    "NIR",
    "POINT_LAYERS",
    "ROUTE_COLOURS",
    "TEMPERATURE",
    "ColourScale",
    "KeyframeDisplay",
    "KeyframeDisplayConfig",
    "RouteDisplay",
    "RouteDisplayConfig",
    "SemanticDisplay",
    "SemanticDisplayConfig",
    "SnakeDisplay",
    "SnakeDisplayConfig",
    "drake_cloud",
    "draw_attribute",
    "draw_classes",
    "draw_dose",
    "draw_keyframe",
    "draw_last_keyframe",
    "draw_regions",
    "draw_routes",
    "draw_source",
    "for_meshcat",
    "height_colours",
    "layer_path",
]
