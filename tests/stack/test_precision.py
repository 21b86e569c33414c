"""Mixed precision: short inside the layers of the predictor, float32 everywhere else."""

import copy

import pytest
import torch
from torch import nn

from diffstack_mmv.stack import MixedPrecision


class Network(nn.Module):
    def __init__(self):
        super().__init__()
        self.recurrent, self.head = nn.GRU(4, 8, batch_first=True), nn.Linear(8, 2)

    def forward(self, sequence):
        states, last = self.recurrent(sequence)
        assert states.dtype == last.dtype == torch.float32
        return self.head(states) @ torch.eye(2)


@pytest.fixture(params=["bfloat16", "float16"])
def networks(request):
    plain = Network()
    mixed = copy.deepcopy(plain)
    MixedPrecision(request.param).apply(mixed)
    return plain, mixed


def test_layers_are_short_and_results_long(networks):
    plain, mixed = networks
    sequence = torch.randn(3, 5, 4)
    expected, result = plain(sequence), mixed(sequence)
    assert result.dtype == torch.float32
    assert 0 < (result - expected).abs().max() < 0.05
    result.sum().backward()
    assert all(p.dtype == p.grad.dtype == torch.float32 for p in mixed.parameters())


def test_a_copy_uses_its_own_weights(networks):
    mixed = copy.deepcopy(networks[1])
    nn.init.zeros_(mixed.head.weight)
    nn.init.zeros_(mixed.head.bias)
    assert (mixed(torch.randn(3, 5, 4)) == 0).all()


def test_an_unknown_type_is_refused():
    with pytest.raises(ValueError, match="`dtype` must be one of bfloat16, float16"):
        MixedPrecision("int8")


@pytest.mark.parametrize("kind", ["bfloat16", "float16"])
@pytest.mark.parametrize("factor", [1e-12, 1.0, 1e12])
def test_gradients_of_any_size_are_those_of_float32(kind, factor):
    plain = nn.Sequential(nn.Linear(4, 16), nn.Tanh(), nn.Linear(16, 2, bias=False))
    mixed, inputs = copy.deepcopy(plain), torch.randn(3, 50, 4, requires_grad=True)
    MixedPrecision(kind).apply(mixed)
    slopes = []
    for network in (plain, mixed):
        loss = factor * network(inputs).square().mean()
        slopes.append(torch.autograd.grad(loss, [inputs, *network.parameters()]))
    for exact, short in zip(*slopes, strict=True):
        assert (short - exact).norm() < 0.02 * exact.norm()


@pytest.mark.parametrize("rows", [0, 4])
def test_without_a_gradient_or_without_rows_nothing_is_divided_by_zero(rows):
    layer = nn.Linear(3, 2)
    MixedPrecision("float16").apply(layer)
    inputs = torch.randn(rows, 3, requires_grad=True)
    (0.0 * layer(inputs)).sum().backward()
    assert (inputs.grad == 0).all()
    assert (layer.weight.grad == 0).all()
