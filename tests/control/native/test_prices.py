"""Plans priced in a library cost what they cost on tensors, with the same gradients."""

import pytest
import torch
from torch.autograd import gradcheck

from diffstack_mmv.control import Batched
from diffstack_mmv.control.native import prices as native
from diffstack_mmv.control.native.prices import prices
from dmmv_conventions.libraries import CannotBuildError

TOLERANCE = {torch.float64: 1e-12, torch.float32: 1e-4}


def among(dtype, plans=3, present=0.7):
    """Plans among agents, each of them with components: cost, its sources, states, controls."""
    generator = torch.Generator().manual_seed(0)

    def drawn(*shape):
        return torch.randn(*shape, generator=generator, dtype=torch.float64).to(dtype)

    place, weight = drawn(2, 4, 3, 3, 2).requires_grad_(), drawn(2, 4, 3).abs().requires_grad_()
    valid = torch.rand(2, 4, generator=generator) < present
    shared = drawn(2).abs().requires_grad_()

    def cost(states, controls, place, weight, valid):
        distance = (states[..., None, None, :, :2] - place).square().sum(-1)
        lack = torch.relu(2.0 - (distance + 1e-6).sqrt()).square()
        near = ((lack * weight.unsqueeze(-1)).sum(-2) * valid.unsqueeze(-1)).sum(-2)
        return shared[0] * near + shared[1] * states.cos().sum(-1) + controls.square().sum(-1)

    sources = [place, weight, shared]
    return cost, (place, weight, valid), sources, drawn(2, plans, 3, 4), drawn(2, plans, 3, 2)


@pytest.mark.parametrize(("dtype", "plans"), [(torch.float64, 11), (torch.float32, 3)])
@pytest.mark.parametrize("present", [0.7, 0.0])
def test_prices_and_gradients_are_those_of_tensors(dtype, plans, present):
    cost, tensors, sources, states, controls = among(dtype, plans, present)
    found = prices(Batched(cost, *tensors), states, controls)
    expected = cost(states, controls, *(each.unsqueeze(1) for each in tensors))
    close = {"rtol": TOLERANCE[dtype], "atol": TOLERANCE[dtype]}
    torch.testing.assert_close(found, expected, **close)
    toward = torch.randn_like(expected)
    toward[:, 1] = 0
    slopes = torch.autograd.grad(found, sources, toward)
    for slope, right in zip(slopes, torch.autograd.grad(expected, sources, toward), strict=True):
        assert slope.isfinite().all()
        torch.testing.assert_close(slope, right, **close)


def test_gradient_is_that_of_the_price():
    cost, (place, weight, valid), _, states, controls = among(torch.float64)

    def priced(place, weight):
        return prices(Batched(cost, place, weight, valid), states, controls)

    assert gradcheck(priced, (place, weight))


def test_plans_with_a_gradient_are_left_to_tensors():
    cost, tensors, _, states, controls = among(torch.float64)
    assert prices(Batched(cost, *tensors), states.requires_grad_(), controls) is None


def test_without_a_compiler_there_are_no_prices(monkeypatch):
    def refused(*_):
        raise CannotBuildError("no compiler")

    monkeypatch.setattr(native, "load", refused)
    place = torch.zeros(1, 2)

    def cost(states, controls, place):
        return (states - place).square().sum(-1) + controls.sum(-1)

    states, controls = torch.zeros(1, 2, 3, 2), torch.zeros(1, 2, 3, 1)
    assert prices(Batched(cost, place), states, controls) is None
    assert prices(Batched(cost, place), states, controls) is None


def test_however_many_plans_and_problems_there_are_it_is_one_library(monkeypatch):
    written, source = [], native.source
    monkeypatch.setattr(native, "source", lambda *told: written.append(told) or source(*told))

    def cost(states, controls, place):
        return (states - place.unsqueeze(-2)).square().sum(-1) + 3 * controls.sum(-1)

    for problems, plans in ((4, 7), (4, 3), (2, 3), (1, 7), (1, 1)):
        place, states = torch.randn(problems, 2), torch.randn(problems, plans, 5, 2)
        controls = torch.randn(problems, plans, 5, 1)
        found = prices(Batched(cost, place), states, controls)
        assert found is not None
        torch.testing.assert_close(found, cost(states, controls, place.unsqueeze(1)))
    assert len(written) == 1


def test_costs_of_tensors_cut_from_others_are_one_library(monkeypatch):
    written, source = [], native.source
    monkeypatch.setattr(native, "source", lambda *told: written.append(told) or source(*told))

    def cost(states, controls, place):
        return (states - place.unsqueeze(-2)).square().sum(-1) - controls.sum(-1)

    for place in (torch.randn(1, 2), torch.randn(1, 30, 2)[:, -1], torch.randn(4, 30, 2)[:, -1]):
        states, controls = torch.randn(len(place), 3, 5, 2), torch.randn(len(place), 3, 5, 1)
        found = prices(Batched(cost, place), states, controls)
        torch.testing.assert_close(found, cost(states, controls, place.unsqueeze(1)))
    assert len(written) == 1


def test_plans_of_other_sizes_or_types_are_left_to_tensors():
    """The library would take their numbers for those of the plans that it was prepared for."""

    def cost(states, controls, place):
        return (states - place.unsqueeze(-2)).square().sum(-1) + controls.square().sum(-1)

    states, controls = torch.randn(3, 4, 6, 2), torch.randn(3, 4, 6, 1)
    ready = native.pricer(Batched(cost, torch.randn(3, 2)), states, controls)
    assert ready(states[:, :1], controls[:, :1]) is not None  # any number of plans
    assert ready(states[:1], controls[:1]) is None
    assert ready(states[:, :, :3], controls[:, :, :3]) is None
    assert ready(states.double(), controls.double()) is None
    assert ready(states, controls.repeat(1, 1, 1, 2)) is None
    for other in (controls[:1], controls[:, :1], controls[:, :, :5], controls[0]):
        assert not ready._fit(states, other)
