"""Identified parameters: fits, local optima, uncertainty, validation, whole studies."""

from diffstack_mmv.identification.inference.assumptions import TrackingAssumptions
from diffstack_mmv.identification.inference.combinations import (
    Combination,
    combinations,
    quantities,
)
from diffstack_mmv.identification.inference.comparison import (
    ModelBuilder,
    ModelComparison,
    ModelResult,
)
from diffstack_mmv.identification.inference.excitation import Excitation, measure_excitation
from diffstack_mmv.identification.inference.identification_problem import (
    FittedMotion,
    IdentificationProblem,
)
from diffstack_mmv.identification.inference.identifier import Identification, Identifier
from diffstack_mmv.identification.inference.influence import CostGradient, regularisation_influence
from diffstack_mmv.identification.inference.optima import (
    LocalOptimum,
    analyse_optimum,
    combined_sensitivity,
    is_same_optimum,
    mixture_variance,
    posterior_shares,
    relevant_optima,
)
from diffstack_mmv.identification.inference.profile_likelihood import (
    ProfileLikelihood,
    profile_likelihoods,
)
from diffstack_mmv.identification.inference.rider_scales import (
    estimate_rider_scales,
    rate_scales,
    thin_samples,
)
from diffstack_mmv.identification.inference.sensitivity import (
    Identifiability,
    IdentifiabilityThresholds,
    InformationDirection,
    Sensitivity,
    describe_direction,
    sensitivity,
)
from diffstack_mmv.identification.inference.starts import calm_starts, error_growth, sobol_starts
from diffstack_mmv.identification.inference.study import IdentificationStudy, StudyResult
from diffstack_mmv.identification.inference.validation import (
    ValidationErrors,
    concatenate_errors,
    drop_last_samples,
    validation_errors,
)

__all__ = [
    "Combination",
    "CostGradient",
    "Excitation",
    "FittedMotion",
    "Identifiability",
    "IdentifiabilityThresholds",
    "Identification",
    "IdentificationProblem",
    "IdentificationStudy",
    "Identifier",
    "InformationDirection",
    "LocalOptimum",
    "ModelBuilder",
    "ModelComparison",
    "ModelResult",
    "ProfileLikelihood",
    "Sensitivity",
    "StudyResult",
    "TrackingAssumptions",
    "ValidationErrors",
    "analyse_optimum",
    "calm_starts",
    "combinations",
    "combined_sensitivity",
    "concatenate_errors",
    "error_growth",
    "describe_direction",
    "drop_last_samples",
    "estimate_rider_scales",
    "is_same_optimum",
    "measure_excitation",
    "mixture_variance",
    "posterior_shares",
    "profile_likelihoods",
    "quantities",
    "rate_scales",
    "regularisation_influence",
    "relevant_optima",
    "sensitivity",
    "sobol_starts",
    "thin_samples",
    "validation_errors",
]
