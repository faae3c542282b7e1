"""What other sensors saw, on the cloud: near-infrared, temperature, dose rate; and surveys brought together."""

from .camera_fusion import CameraFusion, CameraFusionConfig, FusionHealth
from .camera_view import CameraView, LampConfig
from .classes import CLASSES, SemanticClass
from .dose import DoseConfig
from .dose_field import DoseField
from .dose_mapper import DoseMapper, DoseMapperConfig
from .earlier_survey import EarlierSurvey, read_survey
from .heat import HeatConfig, HeatDetector
from .keyframe_assembler import KeyframeAssembler, KeyframeAssemblerConfig
from .painting import Paint, PaintConfig, paint
from .regions import Region
from .seen_space import SeenSpace, seen_space, write_seen
from .semantic_map import SemanticMap, SemanticMapConfig
from .sight import keyframe_rays
from .survey_changes import ChangedObject, SurveyUpdateConfig
from .survey_update import SurveyUpdate, UpdateSummary
from .sweep import PanTiltSweep, SweepConfig, plan_sweep
from .water import WaterConfig, find_puddles, water_probability
from .water_detector import WaterDetector

__all__ = [
    "CLASSES",
    "CameraFusion",
    "CameraFusionConfig",
    "CameraView",
    "ChangedObject",
    "DoseConfig",
    "DoseField",
    "DoseMapper",
    "DoseMapperConfig",
    "EarlierSurvey",
    "FusionHealth",
    "HeatConfig",
    "HeatDetector",
    "KeyframeAssembler",
    "KeyframeAssemblerConfig",
    "LampConfig",
    "Paint",
    "PaintConfig",
    "PanTiltSweep",
    "Region",
    "SeenSpace",
    "SemanticClass",
    "SemanticMap",
    "SemanticMapConfig",
    "SurveyUpdate",
    "SurveyUpdateConfig",
    "SweepConfig",
    "UpdateSummary",
    "WaterConfig",
    "WaterDetector",
    "find_puddles",
    "keyframe_rays",
    "paint",
    "plan_sweep",
    "read_survey",
    "seen_space",
    "water_probability",
    "write_seen",
]
