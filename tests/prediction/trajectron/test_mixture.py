"""Covariances through the dynamics, against autograd and against sampling."""

import pytest
import torch
from torch.autograd import gradcheck
from torch.autograd.functional import jacobian

from diffstack_mmv.dynamics import SingleIntegrator, rollout
from diffstack_mmv.prediction.trajectron.jacobians import (
    Linearisation,
    linearise,
    linearise_shared,
)
from diffstack_mmv.prediction.trajectron.mixture import integrate, propagate
from diffstack_mmv.types import Motion
from tests.prediction.samples import bicycle

MODELS = [bicycle, lambda: bicycle(kinematic=True), SingleIntegrator]


def moving(count=3, speed=4.0):
    zero = torch.zeros(count, dtype=torch.float64)
    velocity = torch.stack([zero + speed, zero], -1)
    return Motion(torch.zeros(count, 2, dtype=torch.float64), zero, velocity, zero)


@pytest.mark.parametrize("model", MODELS)
def test_linearisation_equals_reverse_mode(model):
    dynamics = model().double()
    state, control = (
        torch.rand(2, 3, 4, dtype=torch.float64),
        0.3 * torch.randn(2, 3, 2, dtype=torch.float64),
    )
    found = linearise(dynamics, state, control)
    for index in [(0, 0), (1, 2)]:
        by_state, by_control = jacobian(dynamics, (state[index], control[index]))
        assert torch.allclose(found.state[index], by_state)
        assert torch.allclose(found.control[index], by_control)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("speed", [0.0, 4.0])
def test_integration_has_the_gradient_of_its_value(model, speed):
    dynamics, motion = model().double(), moving(1, speed)
    controls = 0.2 * torch.randn(1, 3, 2, dtype=torch.float64) + torch.tensor([0.3, 0.1])
    factor = 0.3 * torch.eye(2, dtype=torch.float64).expand(1, 3, 2, 2)
    spread = torch.full((1, 4), 0.1, dtype=torch.float64)

    def moments(*inputs):
        return tuple(integrate(dynamics, motion, *inputs))

    inputs = tuple(tensor.clone().requires_grad_() for tensor in (controls, factor, spread))
    assert gradcheck(moments, inputs)


@pytest.mark.parametrize("model", MODELS)
def test_covariance_agrees_with_sampling(model):
    dynamics, samples, steps = model().double(), 20000, 20
    controls = torch.tensor([0.1, 0.05], dtype=torch.float64).expand(1, steps, 2)
    factor = torch.tensor([[0.1, 0.0], [0.02, 0.05]], dtype=torch.float64).expand(1, steps, 2, 2)
    spread = torch.tensor([[0.03, 0.02, 0.02, 0.1]], dtype=torch.float64)
    moments = integrate(dynamics, moving(1), controls, factor, spread)
    start = spread * torch.randn(samples, 4, dtype=torch.float64)
    velocity = torch.stack([4 + start[:, 3], torch.zeros(samples, dtype=torch.float64)], -1)
    state = dynamics.state_on_course(Motion(start[:, :2], start[:, 2], velocity, 0 * start[:, 2]))
    noise = (factor @ torch.randn(samples, steps, 2, 1, dtype=torch.float64)).squeeze(-1)
    end = rollout(dynamics, state, controls + noise)[:, -1, :2]
    scale = end.T.cov().diagonal().sqrt()
    assert ((end.mean(0) - moments.mean[0, -1]).abs() < 0.15 * scale).all()
    assert torch.allclose(
        end.T.cov(),
        moments.covariance[0, -1],
        rtol=0.1,
        atol=0.1 * float(scale.detach().min()) ** 2,
    )


def test_covariances_of_a_linear_system_are_exact():
    a, b = (
        torch.randn(3, 2, 4, 4, dtype=torch.float64),
        torch.randn(3, 2, 4, 2, dtype=torch.float64),
    )
    start = torch.randn(3, 4, 4, dtype=torch.float64)
    factor = torch.randn(3, 2, 2, 2, dtype=torch.float64).tril()
    found = propagate(Linearisation(a, b), start, factor)
    whole = torch.cat(
        [a[:, 1] @ a[:, 0] @ start, a[:, 1] @ b[:, 0] @ factor[:, 0], b[:, 1] @ factor[:, 1]], -1
    )
    assert torch.allclose(found[:, 1], whole @ whole.mT)


@pytest.mark.parametrize("model", MODELS)
def test_shared_linearisation_of_components_that_differ_in_pose_alone_is_exact(model):
    dynamics = model().double()
    heading = (
        dynamics.State._fields.index("heading") if "heading" in dynamics.State._fields else None
    )
    state = torch.rand(2, 1, 3, 4, dtype=torch.float64).expand(2, 5, 3, 4).clone()
    state[..., :2] = torch.randn(2, 5, 3, 2)
    if heading is not None:
        state[..., heading] = 3 * torch.randn(2, 5, 3)
    control = (0.3 * torch.randn(2, 1, 3, 2, dtype=torch.float64)).expand(2, 5, 3, 2)
    exact, shared = linearise(dynamics, state, control), linearise_shared(dynamics, state, control)
    assert torch.allclose(shared.state, exact.state)
    assert torch.allclose(shared.control, exact.control)


def test_propagation_has_the_gradient_of_its_value():
    shapes = [(2, 3, 4, 4), (2, 3, 4, 2), (2, 4, 3), (2, 3, 2, 2)]
    moved, pushed, start, scale = (torch.randn(shape, dtype=torch.float64) for shape in shapes)

    def covariances(moved, pushed, start, scale):
        return propagate(Linearisation(moved, pushed), start, scale)

    inputs = [part.requires_grad_() for part in (moved, pushed, start, scale)]
    assert gradcheck(covariances, inputs)
