"""An earlier survey brought up to date: what stayed, appeared, vanished or was filled in (S0-d)."""

from .earlier_survey import EarlierSurvey, read_survey
from .seen_space import SeenSpace, make_seen_space, read_seen, write_seen
from .sight import keyframe_rays
from .survey_changes import CHANGES, ChangedObject, SurveyUpdateConfig
from .survey_update import SurveyUpdate, UpdateSummary, update_survey

__all__ = [
    "CHANGES",
    "ChangedObject",
    "EarlierSurvey",
    "SeenSpace",
    "SurveyUpdate",
    "SurveyUpdateConfig",
    "UpdateSummary",
    "keyframe_rays",
    "make_seen_space",
    "read_seen",
    "read_survey",
    "update_survey",
    "write_seen",
]
