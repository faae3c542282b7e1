"""Classes of points from what they reflect and how warm they are, thresholds chosen from the data."""

from .class_counts import ClassCounts
from .class_model import CLASS_NAMES, ClassModel, class_probabilities, fit_class_model, four_classes
from .levels import Levels, find_levels
from .point_classes import PointClasses, PointClassesConfig

__all__ = [
    "CLASS_NAMES",
    "ClassCounts",
    "ClassModel",
    "Levels",
    "PointClasses",
    "PointClassesConfig",
    "class_probabilities",
    "find_levels",
    "fit_class_model",
    "four_classes",
]
