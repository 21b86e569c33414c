"""Steps that come with their Jacobians, against forward mode; the kernels run eagerly here."""

import pytest
import torch
from torch.autograd import gradcheck

from diffstack_mmv.dynamics import DiffGM3
from diffstack_mmv.prediction.trajectron import (
    linearise,
    linearise_compiled,
    linearise_compiled_twice,
    linearised_step,
)
from diffstack_mmv.prediction.trajectron.jacobians import linearise_forward, linearised_columns
from diffstack_mmv.prediction.trajectron.linearised_step import (
    Compiled,
    bent_columns,
    linearised_rollout,
)
from diffstack_mmv.prediction.trajectron.mixture import integrate
from diffstack_mmv.vehicles import load_vehicle
from tests.prediction.trajectron.test_mixture import moving

DOUBLE = torch.float64


def model(name="bicycle"):
    return DiffGM3(load_vehicle(name)).double()


def points(count):
    state = 0.2 * torch.randn(count, 8, dtype=DOUBLE)
    state[:, 2] += 4
    return state, 0.3 * torch.randn(count, 2, dtype=DOUBLE)


@pytest.fixture
def interpreted(monkeypatch):
    """The kernels as if compiled, for three columns."""
    for name, function in (("KERNEL", linearised_columns), ("BENT_KERNEL", bent_columns)):
        kernel = Compiled(function)
        kernel.run = kernel.function
        monkeypatch.setattr(linearised_step, name, kernel)
    monkeypatch.setattr(linearised_step, "COLUMNS", 3)
    monkeypatch.setattr(linearised_step, "ROWS", 1)


def sources(dynamics):
    return [each for each in dynamics.parameters() if each.requires_grad]


@pytest.mark.parametrize("name", ["bicycle", "scooter", "tricycle"])
def test_jacobians_with_a_known_pose_are_those_of_forward_mode(name):
    dynamics, point = model(name), points(4)
    found, expected = (form(dynamics, *point) for form in (linearise, linearise_forward))
    toward = [torch.randn_like(matrix) for matrix in expected]
    slopes = [
        torch.autograd.grad(form, sources(dynamics), toward, materialize_grads=True)
        for form in (found, expected)
    ]
    for first, second in ((found, expected), slopes):
        assert all(torch.allclose(*pair) for pair in zip(first, second, strict=True))


@pytest.mark.usefixtures("interpreted")
def test_a_rollout_has_the_gradient_of_its_value():
    dynamics, (state, control) = model(), points(2)

    def rolled(state, controls):
        states, jacobians = linearised_rollout(dynamics, state, controls)
        return states, *jacobians

    inputs = [state.requires_grad_(), torch.stack([control, -control], 1).requires_grad_()]
    assert gradcheck(rolled, inputs, fast_mode=True, rtol=1e-3, atol=1e-5)


@pytest.mark.usefixtures("interpreted")
@pytest.mark.parametrize("learned", [True, False])
def test_compiled_steps_change_nothing(learned):
    dynamics, motion = model(), moving(2)
    for parameter in sources(dynamics):
        parameter.requires_grad_(learned)
    controls = (0.2 * torch.randn(2, 4, 2, dtype=DOUBLE)).requires_grad_()
    factor = 0.3 * torch.eye(2, dtype=DOUBLE).expand(2, 4, 2, 2)
    spread = torch.full((2, 4), 0.1, dtype=DOUBLE, requires_grad=True)
    inputs = [controls, spread, *sources(dynamics)]
    found = []
    for jacobians in (linearise, linearise_compiled, linearise_compiled_twice):
        moments = integrate(dynamics, motion, controls, factor, spread, jacobians)
        toward = [torch.cos(moment.detach() + 1) for moment in moments]
        found.append([*moments, *torch.autograd.grad(moments, inputs, toward)])
    expected, *others = found
    for other in others:
        assert all(torch.allclose(*pair) for pair in zip(expected, other, strict=True))
