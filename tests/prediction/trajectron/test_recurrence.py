"""The recurrence of the decoder, against the same equations one operation at a time."""

import pytest
import torch
from torch.autograd import gradcheck

from diffstack_mmv.prediction.trajectron import recurrence
from diffstack_mmv.prediction.trajectron.recurrence import Weights, emissions

STEPS = 4


def made(rows, hidden=3, controls=2, emitted=5):
    shapes = [
        (rows, 3 * hidden),
        (rows, hidden),
        (3 * hidden, controls),
        (3 * hidden, hidden),
        (3 * hidden,),
        (emitted, hidden),
        (emitted,),
    ]
    return [torch.randn(*shape, dtype=torch.float64).requires_grad_() for shape in shapes]


def written_out(constant, hidden, *tensors):
    weights, size = Weights(*tensors), hidden.shape[-1]
    control = hidden.new_zeros(len(hidden), weights.control.shape[-1])
    emitted = []
    for _ in range(STEPS):
        entering = constant + control @ weights.control.mT
        own = hidden @ weights.hidden.mT + weights.hidden_bias
        gates = torch.sigmoid(entering[:, : 2 * size] + own[:, : 2 * size])
        reset, update = gates.chunk(2, -1)
        candidate = torch.tanh(entering[:, 2 * size :] + reset * own[:, 2 * size :])
        hidden = candidate + update * (hidden - candidate)
        emitted.append(hidden @ weights.head.mT + weights.head_bias)
        control = emitted[-1][:, : control.shape[-1]]
    return torch.stack(emitted)


def unrolled(constant, hidden, *tensors):
    return emissions(constant, hidden, Weights(*tensors), STEPS)


@pytest.mark.parametrize("rows", [0, 1, 5])
@pytest.mark.parametrize("chunk", [2, 640])
def test_value_and_gradient_are_those_of_the_equations(rows, chunk, monkeypatch):
    monkeypatch.setattr(recurrence, "CHUNK", chunk)
    inputs = made(rows)
    found, expected = unrolled(*inputs), written_out(*inputs)
    assert torch.allclose(found, expected)
    with torch.no_grad():
        assert torch.allclose(unrolled(*inputs), expected)
    toward = torch.randn_like(expected)
    slopes = torch.autograd.grad(found, inputs, toward)
    for slope, right in zip(slopes, torch.autograd.grad(expected, inputs, toward), strict=True):
        assert torch.allclose(slope, right)


def test_gradient_is_that_of_the_value():
    assert gradcheck(unrolled, made(2))


def test_a_second_derivative_is_refused():
    inputs = made(2)
    (slope,) = torch.autograd.grad(unrolled(*inputs).square().sum(), inputs[:1], create_graph=True)
    with pytest.raises(RuntimeError, match="differentiate twice"):
        slope.sum().backward()
