"""What an estimate owes to the assumed standard deviations, from dense equations."""

import math
from types import SimpleNamespace

import pytest
import torch

from diffstack_mmv.identification.inference.influence import regularisation_influence
from diffstack_mmv.identification.shooting.condensing import CondensedJacobian
from diffstack_mmv.identification.shooting.problem import COMMAND_DIM, INITIAL_DIM, Unknowns

TRACKS, STEPS, COLUMNS, VALUES = 2, 3, 4, 3
LOCAL = INITIAL_DIM + COMMAND_DIM * STEPS
ROWS = (STEPS + 1) * COLUMNS
STD, SLOPE = torch.tensor([0.5, 2.0, 1.5]), torch.tensor([1.2, 0.7, 3.0])


def linear(steering):
    """A simulator whose residuals are linear, and a fit: derivatives and numbers at random."""
    jacobian = CondensedJacobian(
        torch.randn(TRACKS, ROWS, LOCAL),
        torch.randn(TRACKS, ROWS, VALUES),
        torch.zeros(TRACKS, ROWS),
        *(None, None, None),
    )
    parameters = SimpleNamespace(
        prior=SimpleNamespace(std=STD), slope=lambda _: SLOPE, penalty=torch.zeros_like
    )
    simulator = SimpleNamespace(
        jacobian=lambda *_: jacobian,
        parameters=parameters,
        vehicle=SimpleNamespace(has_steering_prior=steering),
    )
    unknowns = Unknowns(
        torch.randn(TRACKS, INITIAL_DIM),
        torch.randn(TRACKS, STEPS, COMMAND_DIM),
        torch.zeros(TRACKS, 0, 1),
    )
    simulated = SimpleNamespace(residual=torch.randn(TRACKS, STEPS + 1, COLUMNS))
    fit = SimpleNamespace(theta=torch.zeros(VALUES), fitted=(unknowns, simulated, None))
    return simulator, fit, jacobian


def dense(jacobian):
    """Derivatives of all residuals, of tracks after tracks, by all unknowns and θ last."""
    local = torch.block_diag(*jacobian.local)
    return torch.cat([local, jacobian.shared.flatten(0, 1)], 1)


def moved(jacobian, gradient, active):
    """2 ln 2 H⁻¹ ∇J_k of the values in prior standard deviations, others fixed."""
    rows = dense(jacobian)
    precision = torch.cat([torch.ones(TRACKS * LOCAL), (SLOPE / STD).square()])
    hessian = rows.mT @ rows + precision.diag()
    free = torch.cat([torch.ones(TRACKS * LOCAL) > 0, active])
    change = torch.zeros(len(free))
    change[free] = 2 * math.log(2) * torch.linalg.solve(hessian[free][:, free], gradient[free])
    return change[-VALUES:] * SLOPE / STD


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("active", [[True, True, True], [True, False, True]])
def test_the_estimate_moves_by_the_inverse_hessian_times_the_gradient_of_a_part(active):
    simulator, fit, jacobian = linear(True)
    active = torch.tensor(active)
    told = regularisation_influence(simulator, None, fit, active)
    assert set(told) == {"jerk_mps3", "curvature_rate", "steer_rate_radps"}
    unknowns, simulated, _ = fit.fitted
    for column, name in enumerate(("jerk_mps3", "curvature_rate")):
        # the value at the start is the fifth or sixth of six, then come the rates in turns
        own = torch.arange(LOCAL) % 2 == column
        own[:4] = False
        local = torch.cat([unknowns.initial, unknowns.rates.flatten(1)], 1) * own
        gradient = torch.cat([local.flatten(), torch.zeros(VALUES)])
        torch.testing.assert_close(told[name], moved(jacobian, gradient, active))
    steering = torch.zeros_like(simulated.residual)
    steering[..., 2] = simulated.residual[..., 2]
    gradient = dense(jacobian).mT @ steering.flatten()
    torch.testing.assert_close(told["steer_rate_radps"], moved(jacobian, gradient, active))


@pytest.mark.usefixtures("unchecked")
def test_nothing_is_owed_to_a_prior_of_the_steering_that_there_is_not():
    simulator, fit, _ = linear(False)
    told = regularisation_influence(simulator, None, fit, torch.ones(VALUES) > 0)
    assert set(told) == {"jerk_mps3", "curvature_rate"}
