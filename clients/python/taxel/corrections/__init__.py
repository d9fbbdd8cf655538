"""Corrected models: the effects that a base model lacks, and how they are added to its prediction."""

from taxel.corrections.calibrated import Calibrated
from taxel.corrections.calibration import CALIBRATION_AGE, CALIBRATION_EXTRAS, OffsetCalibration
from taxel.corrections.correction import Correction
from taxel.corrections.effect import AppliedEffect, Parameter, Term
from taxel.corrections.frame import Frame
from taxel.corrections.limit import Limit
from taxel.corrections.mix import Leak, Mix
from taxel.corrections.places import Places
from taxel.corrections.substitute import Substitute
from taxel.corrections.weighted import ONE, Weighted

__all__ = [
    "CALIBRATION_AGE",
    "CALIBRATION_EXTRAS",
    "ONE",
    "AppliedEffect",
    "Calibrated",
    "Correction",
    "Frame",
    "Leak",
    "Limit",
    "Mix",
    "OffsetCalibration",
    "Parameter",
    "Places",
    "Substitute",
    "Term",
    "Weighted",
]
