"""The adjoint of a rollout, against autograd through every step."""

import pytest
import torch

from diffstack_mmv.dynamics import SingleIntegrator, rollout
from diffstack_mmv.prediction.trajectron.adjoint import rolled_out
from tests.prediction.samples import bicycle


@pytest.mark.parametrize(
    "model",
    [bicycle, lambda: bicycle(kinematic=True), SingleIntegrator],
    ids=["unicycle", "kbm", "integrator"],
)
@pytest.mark.parametrize("leading", [(), (0,), (3, 2)])
@pytest.mark.parametrize("speed", [0.0, 2.0])
def test_it_has_the_gradient_of_the_rollout(model, leading, speed):
    dynamics = model().double()
    state = torch.tensor([0.0, 0.0, 0.3, speed], dtype=torch.float64).expand(*leading, 4).clone()
    controls = 0.5 * torch.randn(*leading, 5, 2, dtype=torch.float64)
    sources = [state.requires_grad_(), controls.requires_grad_()]
    sources += [p for p in dynamics.parameters() if p.requires_grad]
    found, expected = (form(dynamics, state, controls) for form in (rolled_out, rollout))
    assert torch.allclose(found, expected)
    toward = torch.randn_like(expected)
    slopes, right = (torch.autograd.grad(each, sources, toward) for each in (found, expected))
    assert all(torch.allclose(*pair) for pair in zip(slopes, right, strict=True))


def test_a_second_derivative_is_refused():
    controls = torch.randn(2, 3, 2, requires_grad=True)
    states = rolled_out(SingleIntegrator(), torch.zeros(2, 4), controls)
    (slope,) = torch.autograd.grad(states.square().sum(), controls, create_graph=True)
    with pytest.raises(RuntimeError, match="differentiate twice"):
        slope.sum().backward()
