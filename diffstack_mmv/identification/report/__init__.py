"""Results of an identification as plain numbers and sentences."""

from diffstack_mmv.identification.report.lean import lean_agreement
from diffstack_mmv.identification.report.remarks import (
    all_remarks,
    dependence_on_assumptions,
    estimates_at_the_edge,
    information_directions,
    lagging_alone,
    misfit,
    other_optima,
    smoothed_beside_instruments,
    unobservable_parameters,
)
from diffstack_mmv.identification.report.result import identification_result, vehicle_provenance
from diffstack_mmv.identification.report.summary import overall_rmse, summarise, tracking_losses

__all__ = [
    "all_remarks",
    "dependence_on_assumptions",
    "estimates_at_the_edge",
    "identification_result",
    "lagging_alone",
    "information_directions",
    "lean_agreement",
    "misfit",
    "other_optima",
    "overall_rmse",
    "smoothed_beside_instruments",
    "summarise",
    "tracking_losses",
    "unobservable_parameters",
    "vehicle_provenance",
]
