"""Laying one cloud on another: the pose between two scans, and how far it can be trusted."""

from .class_correlation import ClassFix, correlate_classes
from .config import METHODS, IcpConfig, RegistrationConfig, SurfacesConfig
from .constraint import AXES, constraint, undo_unheld_motion
from .incidence import incidence_cosines
from .registration import Target, prepare_target, register
from .result import Axis, Registration, covariance_at, placed
from .surfels import is_organised

__all__ = [
    "AXES",
    "METHODS",
    "Axis",
    "ClassFix",
    "IcpConfig",
    "Registration",
    "RegistrationConfig",
    "SurfacesConfig",
    "Target",
    "constraint",
    "correlate_classes",
    "covariance_at",
    "incidence_cosines",
    "is_organised",
    "placed",
    "prepare_target",
    "register",
    "undo_unheld_motion",
]
