"""Corrected models: the effects that a base model lacks, and how they are added to its prediction."""

from taxel.corrections.calibrated import Calibrated
from taxel.corrections.calibration import CALIBRATION_AGE, CALIBRATION_EXTRAS, OffsetCalibration
from taxel.corrections.compose import Composition
from taxel.corrections.correction import Correction
from taxel.corrections.count_limits import CountLimits
from taxel.corrections.crosstalk import Crosstalk, Leak
from taxel.corrections.effect import AppliedEffect, Parameter, Term
from taxel.corrections.fault import Fault
from taxel.corrections.frame import Frame
from taxel.corrections.location import Location, location_design
from taxel.corrections.random_features import RandomFeatures
from taxel.corrections.saturation import Saturation, saturation_design
from taxel.corrections.weighted import ONE, Shape, Weighted, weighted_shape

__all__ = [
    "CALIBRATION_AGE",
    "CALIBRATION_EXTRAS",
    "ONE",
    "AppliedEffect",
    "Calibrated",
    "Composition",
    "Correction",
    "CountLimits",
    "Crosstalk",
    "Fault",
    "Frame",
    "Leak",
    "Location",
    "OffsetCalibration",
    "Parameter",
    "RandomFeatures",
    "Saturation",
    "Shape",
    "Term",
    "Weighted",
    "location_design",
    "saturation_design",
    "weighted_shape",
]
