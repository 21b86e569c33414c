"""How much the estimate owes to the regularisation rather than to the positions."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffstack_mmv.identification.shooting.block_arrowhead import solve_arrowhead
from diffstack_mmv.identification.shooting.condensing import CondensedJacobian
from diffstack_mmv.identification.shooting.fit import ParameterFit, in_prior_deviations
from diffstack_mmv.identification.shooting.linearisation import TrackSimulation, TrackSimulator
from diffstack_mmv.identification.shooting.normal_equations import normal_equations, stack_unknowns
from diffstack_mmv.identification.shooting.problem import (
    COMMAND_DIM,
    INITIAL_DIM,
    TrackingProblem,
    Unknowns,
)

LN_2 = 0.6931471805599453


def regularisation_influence(
    simulator: TrackSimulator,
    problem: TrackingProblem,
    fit: ParameterFit,
    active: Bool[Tensor, " p"],
) -> dict[str, Float[Tensor, " p"]]:
    """Change of the values if one assumed standard deviation were twice as large.

    With J_k the part of the cost that σ_k scales, ∂J_k/∂ln σ_k = -2 J_k, and the optimum moves by
    -H⁻¹ ∂²J/∂(z, θ)∂ln σ_k = 2 H⁻¹ ∇J_k, to first order.

    Args:
        simulator: Model and residuals.
        problem: The fitted tracks.
        fit: The solution.
        active: Which entries of θ were fitted.

    Returns:
        Change of each value, in units of its prior standard deviation, by the name of the setting.
    """
    unknowns, simulated, _ = fit.fitted
    jacobian = simulator.jacobian(fit.theta, problem, unknowns, simulated)
    plain = normal_equations(jacobian, simulated.residual, unknowns)
    system = in_prior_deviations(plain, simulator, fit.theta).restricted(active)
    gradients = {
        name: _rate_gradient(unknowns, index, int(active.sum()))
        for index, name in enumerate(("jerk_mps3", "curvature_rate"))
    }
    vehicle = simulator.vehicle
    if vehicle.has_steering_prior:
        gradients["steer_rate_radps"] = _steering_gradient(jacobian, simulated, active)
    unit = (simulator.parameters.prior.std / simulator.parameters.slope(fit.theta))[active]
    influence = {}
    for name, gradient in gradients.items():
        moved = system._replace(
            local_gradient=-2 * gradient.local, shared_gradient=-2 * (gradient.shared * unit)
        )
        change = fit.theta.new_zeros(len(fit.theta))
        change[active] = solve_arrowhead(moved).shared
        influence[name] = LN_2 * change
    return influence


class CostGradient(NamedTuple):
    """Gradient of a part of the cost."""

    local: Float[Tensor, "N z"]  # by the unknowns of each track
    shared: Float[Tensor, " p"]  # by the active entries of θ


def _rate_gradient(unknowns: Unknowns, index: int, parameters: int) -> CostGradient:
    """Gradient of the regularisation of one of the rates, and of the initial value behind it."""
    rates = torch.zeros_like(unknowns.rates)
    rates[..., index] = unknowns.rates[..., index]
    initial, column = torch.zeros_like(unknowns.initial), INITIAL_DIM - COMMAND_DIM + index
    initial[:, column] = unknowns.initial[:, column]
    local = stack_unknowns(Unknowns(initial, rates, unknowns.nodes))
    return CostGradient(local, rates.new_zeros(parameters))


def _steering_gradient(
    jacobian: CondensedJacobian, simulated: TrackSimulation, active: Bool[Tensor, " p"]
) -> CostGradient:
    """Gradient of the prior on the steering rate, the third residual."""
    steering = torch.zeros_like(simulated.residual)
    steering[..., 2] = simulated.residual[..., 2]
    rows = steering.flatten(1).unsqueeze(-1)
    shared = (jacobian.shared.mT @ rows).sum((0, 2))[active]
    return CostGradient((jacobian.local.mT @ rows).squeeze(-1), shared)
