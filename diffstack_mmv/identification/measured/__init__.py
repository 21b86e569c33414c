"""Identification from rides whose steering and speed were measured."""

from diffstack_mmv.identification.measured.ego import EgoEstimator, ego_estimator
from diffstack_mmv.identification.measured.fit import MeasuredFitter
from diffstack_mmv.identification.measured.fitted import MeasuredFit
from diffstack_mmv.identification.measured.instruments import (
    Gaussian,
    InstrumentPriors,
    MeasurementNoise,
)
from diffstack_mmv.identification.measured.remarks import measured_remarks
from diffstack_mmv.identification.measured.report import measured_result, measured_tables
from diffstack_mmv.identification.measured.rides import (
    MeasuredRide,
    RideWindows,
    RideWindowSettings,
    cut_windows,
    measured_rides,
)
from diffstack_mmv.identification.measured.simulator import RideSimulator
from diffstack_mmv.identification.measured.study import MeasuredStudy, MeasuredStudyResult
from diffstack_mmv.identification.measured.validation import (
    held_out_errors,
    paired_by_recording,
)

__all__ = [
    "EgoEstimator",
    "Gaussian",
    "InstrumentPriors",
    "MeasuredFit",
    "MeasuredFitter",
    "MeasuredRide",
    "MeasuredStudy",
    "MeasuredStudyResult",
    "MeasurementNoise",
    "RideSimulator",
    "RideWindows",
    "RideWindowSettings",
    "cut_windows",
    "ego_estimator",
    "held_out_errors",
    "measured_remarks",
    "measured_result",
    "measured_rides",
    "measured_tables",
    "paired_by_recording",
]
