"""What speaks against a fit of measured rides."""

from diffstack_mmv.identification.measured.instruments import INSTALLED_NAMES
from diffstack_mmv.identification.measured.study import MeasuredStudyResult
from diffstack_mmv.identification.report import estimates_at_the_edge

FAR = 3.0
"""Prior deviations from which on what is installed is not what was taken for it."""


def measured_remarks(result: MeasuredStudyResult) -> list[str]:
    """What speaks against the fit of the identified model: its vehicle may be another one."""
    simulator, fit, *_ = next(iter(result.models.values()))
    shared, count = fit.point.shared, len(simulator.parameters)
    away = fit.unknowns.penalty(shared)[count:].abs().tolist()
    return estimates_at_the_edge(simulator.parameters, shared[:count]) + [
        f"The estimate of {name} lies {each:.1f} deviations from its prior: check the columns "
        "`steer` and `speed`, and the vehicle."
        for name, each in zip(INSTALLED_NAMES, away, strict=True)
        if each > FAR
    ]
