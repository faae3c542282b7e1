"""Laying one cloud on another: the pose between two scans, and how far it can be trusted."""

from .constraint import AXES, constraint, undo_unheld_motion
from .open3d_icp import METHODS, Registration, RegistrationConfig, register

__all__ = [
    "AXES",
    "METHODS",
    "Registration",
    "RegistrationConfig",
    "constraint",
    "register",
    "undo_unheld_motion",
]
