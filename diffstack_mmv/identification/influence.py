"""How much the estimate owes to the regularisation rather than to the positions."""

from jaxtyping import Float
from torch import Tensor

from diffstack_mmv.identification.arrow import solve
from diffstack_mmv.identification.fit import Fit, in_deviations
from diffstack_mmv.identification.linearisation import Tracker, flat, normal_equations
from diffstack_mmv.identification.problem import INTENTION, PLACEMENT, Problem, Unknowns

LN_2 = 0.6931471805599453


def regularisation_influence(
    tracker: Tracker, problem: Problem, fit: Fit, active: Tensor
) -> dict[str, Float[Tensor, " p"]]:
    """Change of the values if one assumed standard deviation were twice as large.

    With J_k the part of the cost that σ_k scales, ∂J_k/∂ln σ_k = -2 J_k, and the optimum moves by
    -H⁻¹ ∂²J/∂(z, θ)∂ln σ_k = 2 H⁻¹ ∇J_k, to first order.

    Args:
        tracker: Model and residuals.
        problem: The fitted tracks.
        fit: The solution.
        active: Which entries of θ were fitted.

    Returns:
        Change of each value, in units of its prior standard deviation, by the name of the setting.
    """
    unknowns, simulated, _ = fit.fitted
    jacobian = tracker.jacobian(fit.theta, problem, unknowns, simulated)
    plain = normal_equations(jacobian, simulated.residual, unknowns)
    arrow = in_deviations(plain, tracker, fit.theta).restricted(active)
    own = {}
    for index, name in enumerate(("jerk_mps3", "curvature_rate")):
        rates = unknowns.rates.new_zeros(unknowns.rates.shape)
        rates[..., index] = unknowns.rates[..., index]
        start = unknowns.placement.new_zeros(len(rates), PLACEMENT)
        start[:, PLACEMENT - INTENTION + index] = unknowns.placement[
            :, PLACEMENT - INTENTION + index
        ]
        own[name] = (
            flat(Unknowns(start, rates, unknowns.nodes)),
            fit.theta.new_zeros(int(active.sum())),
        )
    if tracker.vehicle.settings.steer_rate_radps is not None and tracker.vehicle.steer is not None:
        only = simulated.residual.new_zeros(simulated.residual.shape)
        only[..., 2] = simulated.residual[..., 2]
        rows = only.flatten(1).unsqueeze(-1)
        shared = (jacobian.shared.mT @ rows).sum((0, 2))[active]
        own["steer_rate_radps"] = ((jacobian.own.mT @ rows).squeeze(-1), shared)
    unit = tracker.parameters.prior.std / tracker.parameters.slope(fit.theta)
    found = {}
    for name, (track_part, shared_part) in own.items():
        step = solve(
            arrow._replace(
                own_gradient=-2 * track_part, shared_gradient=-2 * (shared_part * unit[active])
            )
        ).shared
        change = fit.theta.new_zeros(len(fit.theta))
        change[active] = step
        found[name] = LN_2 * change
    return found
