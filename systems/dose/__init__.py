"""Dose rate from the counts of a gamma counter: background, sources, and the field that they make."""

from .dose_estimate import DoseConfig, estimate_dose
from .dose_field import DoseField, DoseHealth, DoseReadings, SourceEstimate
from .dose_mapper import DoseMapper, DoseMapperConfig

__all__ = [
    "DoseConfig",
    "DoseField",
    "DoseHealth",
    "DoseMapper",
    "DoseMapperConfig",
    "DoseReadings",
    "SourceEstimate",
    "estimate_dose",
]
