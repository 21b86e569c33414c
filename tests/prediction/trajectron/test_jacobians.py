"""Jacobians in closed form, against forward mode."""

import pytest
import torch

from diffstack_mmv.dynamics import DiffGM3, DiffKBM, ReversingFloor, SingleIntegrator, SoftplusFloor
from diffstack_mmv.prediction.trajectron import jacobians
from diffstack_mmv.prediction.trajectron.jacobians import (
    has_closed_form,
    linearise,
    linearise_forward,
)
from diffstack_mmv.vehicles import load_vehicle
from tests.prediction.samples import bicycle

MODELS = [
    bicycle,
    lambda: bicycle(kinematic=True),
    lambda: DiffKBM(load_vehicle("scooter"), 0.1, SoftplusFloor()),
    lambda: DiffKBM(load_vehicle("scooter"), 0.1, ReversingFloor(1.0)),
    SingleIntegrator,
]


def points(leading):
    """Also at rest, far beyond the limits of the controls, and braking to a stop."""
    state = torch.randn(*leading, 4, dtype=torch.float64)
    control = 4 * torch.randn(*leading, 2, dtype=torch.float64)
    state[..., 3] = torch.where(torch.rand(leading) < 0.3, 0.0, state[..., 3].abs())
    return state.requires_grad_(), control.requires_grad_()


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("leading", [(5, 2, 6), (40,), (), (0, 3)])
def test_closed_forms_and_their_derivatives_are_those_of_forward_mode(model, leading):
    dynamics, (state, control) = model().double(), points(leading)
    assert has_closed_form(dynamics)
    found, expected = (form(dynamics, state, control) for form in (linearise, linearise_forward))
    sources = [state, control, *(p for p in dynamics.parameters() if p.requires_grad)]
    toward = [torch.randn_like(matrix) for matrix in expected]
    slopes = [
        torch.autograd.grad(
            [m for m in form if m.requires_grad],
            sources,
            [t for t, m in zip(toward, form, strict=True) if m.requires_grad],
            materialize_grads=True,
            allow_unused=True,
        )
        for form in (found, expected)
    ]
    for first, second in ((found, expected), slopes):
        assert all(torch.allclose(*pair) for pair in zip(first, second, strict=True))


def test_a_model_with_another_step_has_no_closed_form_of_its_parent(monkeypatch):
    class Slow(SingleIntegrator):
        def step(self, state, control):
            return 0.5 * super().step(state, control)

    assert not has_closed_form(Slow())
    monkeypatch.setattr(jacobians, "_CLOSED_FORMS", {})
    state, control = torch.randn(3, 4), torch.randn(3, 2)
    whole = linearise(SingleIntegrator(), state, control)
    assert torch.allclose(linearise(Slow(), state, control).state, 0.5 * whole.state)


@pytest.mark.parametrize("name", ["bicycle", "scooter", "tricycle"])
def test_jacobians_with_a_known_pose_are_those_of_forward_mode(name):
    dynamics = DiffGM3(load_vehicle(name)).double()
    state = 0.2 * torch.randn(4, 8, dtype=torch.float64)
    state[:, 2] += 4
    point = state, 0.3 * torch.randn(4, 2, dtype=torch.float64)
    found, expected = (form(dynamics, *point) for form in (linearise, linearise_forward))
    toward = [torch.randn_like(matrix) for matrix in expected]
    sources = [each for each in dynamics.parameters() if each.requires_grad]
    slopes = [
        torch.autograd.grad(form, sources, toward, materialize_grads=True)
        for form in (found, expected)
    ]
    for first, second in ((found, expected), slopes):
        assert all(torch.allclose(*pair) for pair in zip(first, second, strict=True))


def test_a_single_point_has_the_jacobians_of_a_batch():
    dynamics = DiffGM3(load_vehicle("bicycle")).double()
    state, control = torch.rand(8, dtype=torch.float64), torch.rand(2, dtype=torch.float64)
    one, batch = (
        linearise(dynamics, state, control),
        linearise(dynamics, state[None], control[None]),
    )
    for single, row in zip(one, batch, strict=True):
        torch.testing.assert_close(single, row[0])
