"""System identification: physical parameters from tracks, with or without recorded controls."""

from diffstack_mmv.identification.case import Case, Explained, lean_agreement
from diffstack_mmv.identification.excitation import beyond_limits
from diffstack_mmv.identification.fit import Data, EarlyStopping, Fit
from diffstack_mmv.identification.identify import Identification, Identifier
from diffstack_mmv.identification.linearisation import Tracker
from diffstack_mmv.identification.nested import Nested
from diffstack_mmv.identification.parameters import LearnedParameters
from diffstack_mmv.identification.problem import TrackedVehicle, TrackingSettings
from diffstack_mmv.identification.profile import profiles
from diffstack_mmv.identification.rider import ridden
from diffstack_mmv.identification.sensitivity import Thresholds, Verdict
from diffstack_mmv.identification.shooting import Shooting
from diffstack_mmv.identification.stretches import (
    Division,
    ExcitingChoice,
    LongestChoice,
    RandomChoice,
    Stretch,
    StretchSettings,
    batch,
    cut,
    divide,
)
from diffstack_mmv.identification.summary import losses, summarise
from diffstack_mmv.identification.tracking import LevenbergMarquardt, track
from diffstack_mmv.identification.validation import HeldOut, Studied, Study, folds, held_out

__all__ = [
    "Case",
    "Data",
    "Division",
    "EarlyStopping",
    "ExcitingChoice",
    "Explained",
    "Fit",
    "HeldOut",
    "Identification",
    "Identifier",
    "LearnedParameters",
    "LevenbergMarquardt",
    "LongestChoice",
    "Nested",
    "RandomChoice",
    "Shooting",
    "Stretch",
    "Studied",
    "Study",
    "StretchSettings",
    "Thresholds",
    "TrackedVehicle",
    "Tracker",
    "TrackingSettings",
    "Verdict",
    "batch",
    "beyond_limits",
    "cut",
    "divide",
    "folds",
    "held_out",
    "lean_agreement",
    "losses",
    "profiles",
    "ridden",
    "summarise",
    "track",
]
