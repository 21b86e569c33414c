"""The LSTM over tracks with gaps, against `LSTMCell` step by step."""

import pytest
import torch
from torch.autograd import gradcheck

from diffstack_mmv.prediction.trajectron.memory import MaskedLSTM, last_of_valid


def memory(inputs, hidden, compiled):
    lstm = MaskedLSTM(inputs, hidden)
    if compiled:
        lstm.compile_kernels()
    return lstm


def written_out(lstm, features, valid):
    hidden = memory = features.new_zeros(len(features), lstm.cell.hidden_size)
    for row in range(features.shape[1]):
        keep = valid[:, row].unsqueeze(-1)
        after = lstm.cell(features[:, row], (hidden, memory))
        hidden = torch.where(keep, after[0], hidden)
        memory = torch.where(keep, after[1], memory)
    return hidden


@pytest.mark.parametrize(("rows", "width"), [(0, 3), (1, 3), (40, 3), (40, 15)])
@pytest.mark.parametrize("compiled", [False, True])
def test_value_and_gradient_are_those_of_the_cell(rows, width, compiled):
    lstm = memory(width, 5, compiled).double()
    features = torch.randn(rows, 6, width, dtype=torch.float64, requires_grad=True)
    valid = torch.rand(rows, 6) > 0.4
    found, expected = lstm(features, valid), written_out(lstm, features, valid)
    assert torch.allclose(found, expected)
    inputs, toward = [features, *lstm.parameters()], torch.randn_like(expected)
    slopes = torch.autograd.grad(found, inputs, toward)
    for slope, right in zip(slopes, torch.autograd.grad(expected, inputs, toward), strict=True):
        assert torch.allclose(slope, right)


@pytest.mark.parametrize("rows", [1, 40])
def test_the_form_for_a_gpu_has_the_same_value_and_gradient(rows):
    lstm = memory(3, 5, compiled=False).double()
    features = torch.randn(rows, 6, 3, dtype=torch.float64, requires_grad=True)
    valid = torch.rand(rows, 6) > 0.4
    valid[0] = False
    found, expected = last_of_valid(lstm.cell, features, valid), written_out(lstm, features, valid)
    assert torch.allclose(found, expected)
    inputs, toward = [features, *lstm.parameters()], torch.randn_like(expected)
    slopes = torch.autograd.grad(found, inputs, toward)
    for slope, right in zip(slopes, torch.autograd.grad(expected, inputs, toward), strict=True):
        assert torch.allclose(slope, right)


@pytest.mark.parametrize("compiled", [False, True])
def test_what_a_gap_holds_does_not_matter(compiled):
    lstm, features, valid = memory(3, 5, compiled), torch.randn(9, 6, 3), torch.rand(9, 6) > 0.4
    gaps = features.masked_fill(~valid.unsqueeze(-1), torch.nan)
    found = lstm(gaps, valid)
    assert torch.equal(found, lstm(features, valid))
    assert all(
        slope.isfinite().all() for slope in torch.autograd.grad(found.sum(), lstm.parameters())
    )


@pytest.mark.parametrize("compiled", [False, True])
def test_gradient_is_that_of_the_value(compiled):
    lstm, valid = memory(2, 2, compiled).double(), torch.tensor([[True, False, True]])
    features = torch.randn(1, 3, 2, dtype=torch.float64, requires_grad=True)
    assert gradcheck(lambda inputs: lstm(inputs, valid), features)


def test_a_second_derivative_is_refused():
    lstm, features = MaskedLSTM(2, 2), torch.randn(1, 3, 2, requires_grad=True)
    loss = lstm(features, torch.ones(1, 3, dtype=torch.bool)).square().sum()
    (slope,) = torch.autograd.grad(loss, features, create_graph=True)
    with pytest.raises(RuntimeError, match="differentiate twice"):
        slope.sum().backward()
