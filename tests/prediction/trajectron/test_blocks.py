"""Libraries of the predictor give what tensors give, with the same gradients."""

import pytest
import torch
from torch.autograd import gradcheck

from diffstack_mmv.dynamics import DiffKBM, SingleIntegrator
from diffstack_mmv.prediction.trajectron import blocks
from diffstack_mmv.prediction.trajectron.blocks import Blocks
from diffstack_mmv.prediction.trajectron.decoder import ControlDecoder
from diffstack_mmv.prediction.trajectron.mixture import PositionMoments
from diffstack_mmv.prediction.trajectron.paths import path_scores
from diffstack_mmv.vehicles import load_vehicle

PRECISE = [(torch.float64, 1e-12), (torch.float32, 1e-4)]


def decoder(hidden, horizon, hold, dtype):
    torch.manual_seed(0)
    made = ControlDecoder(
        DiffKBM(load_vehicle("bicycle"), 0.1), 2, 1, horizon, hidden=hidden, hold_steps=hold
    )
    for head in (made.mean_head, made.scale_head):
        torch.nn.init.normal_(head.weight, std=0.5)
    return made.to(dtype)


def rows(count, made, dtype):
    """Constant input, first state, and controls at rest."""
    size, steps = made.gate_hidden.in_features, made.horizon_steps
    shapes = (count, 3 * size), (count, size), (count, steps, made.dynamics.control_dim)
    return [torch.randn(*shape, dtype=dtype).requires_grad_() for shape in shapes]


def sloped(made, results, inputs, toward):
    sources = [*inputs, *(each for each in made.parameters() if each.requires_grad)]
    return torch.autograd.grad(results, sources, toward, allow_unused=True, materialize_grads=True)


@pytest.mark.parametrize(("dtype", "tolerance"), PRECISE)
@pytest.mark.parametrize(
    ("count", "hidden", "horizon", "hold"), [(1, 3, 4, 1), (70, 9, 5, 2), (67, 16, 3, 1)]
)
def test_controls_are_those_of_tensors(count, hidden, horizon, hold, dtype, tolerance):
    made = decoder(hidden, horizon, hold, dtype)
    inputs = rows(count, made, dtype)
    expected = made._controls(*inputs)
    toward = [torch.randn_like(each) for each in expected]
    for each in toward:
        each[1::3] = 0  # rows without a gradient
    right = sloped(made, expected, inputs, toward)
    made.blocks = Blocks()
    found = made._controls(*inputs)
    close = {"rtol": tolerance, "atol": tolerance}
    torch.testing.assert_close(found, expected, **close)
    torch.testing.assert_close(sloped(made, found, inputs, toward), right, **close)


def test_their_gradient_is_that_of_the_value():
    made = decoder(3, 3, 1, torch.float64)
    made.blocks = Blocks()
    assert gradcheck(made._controls, rows(2, made, torch.float64))


def test_without_any_gradient_slopes_are_zero():
    made = decoder(9, 3, 1, torch.float64)
    made.blocks = Blocks()
    inputs = rows(5, made, torch.float64)
    results = made._controls(*inputs)
    found = sloped(made, results, inputs, [torch.zeros_like(each) for each in results])
    assert all((slope == 0).all() for slope in found)


def paths(count, components, steps, dtype):
    torch.manual_seed(1)
    mean = torch.randn(count, components, steps, 2, dtype=dtype)
    factor = 0.3 * torch.randn(count, components, steps, 2, 2, dtype=dtype)
    covariance = factor @ factor.mT + 0.05 * torch.eye(2, dtype=dtype)
    log_weight = (2 * torch.randn(count, components, dtype=dtype)).log_softmax(-1)
    truth, valid = torch.randn(count, steps, 2, dtype=dtype), torch.rand(count, steps) < 0.8
    valid[0] = False
    learned = [each.requires_grad_() for each in (mean, covariance, log_weight)]
    return learned, truth, valid


@pytest.mark.parametrize(("dtype", "tolerance"), PRECISE)
@pytest.mark.parametrize("sizes", [(1, 1, 1), (70, 5, 30), (3, 16, 9)])
@pytest.mark.parametrize("weighed", [True, False])
def test_scores_of_paths_are_those_of_tensors(sizes, weighed, dtype, tolerance):
    (mean, covariance, log_weight), truth, valid = paths(*sizes, dtype)
    sources = [mean, covariance, *([log_weight] if weighed else [])]
    toward, results = torch.randn(sizes[:2], dtype=dtype), []
    for form in (None, Blocks()):
        moments, weight = PositionMoments(mean, covariance), log_weight if weighed else None
        scores = path_scores(moments, weight, truth, valid, form)
        whole = (toward * (scores.log_density + 3 * scores.energy.unsqueeze(-1))).sum()
        results.append((*scores, *torch.autograd.grad(whole, sources)))
    for expected, found in zip(*results, strict=True):
        scale = expected.detach().abs().max().clamp_min(1)
        torch.testing.assert_close(found / scale, expected / scale, rtol=0, atol=tolerance)


@pytest.mark.parametrize("rows", [1, 2, 5, 40])
def test_a_gradient_that_is_one_number_for_all_rows_lasts_as_long_as_the_call(rows):
    """A copy of it was given back before the library read it, and was written over at times."""
    (mean, covariance, log_weight), truth, valid = paths(rows, 3, 4, torch.float64)
    moments = PositionMoments(mean, covariance)

    def slope(toward):
        scores = path_scores(moments, log_weight.detach(), truth, valid, Blocks())
        return torch.autograd.grad(scores.energy, mean, toward)[0]

    expected = slope(torch.ones(rows, dtype=torch.float64))
    for _ in range(50):
        assert torch.equal(slope(torch.ones((), dtype=torch.float64).expand(rows)), expected)


def test_components_that_do_not_count_are_not_moved():
    (mean, covariance, _), truth, valid = paths(2, 3, 4, torch.float64)
    valid[:] = True
    log_weight = torch.tensor([0.6, 0.39, 0.01], dtype=torch.float64).log().expand(2, 3)
    scores = path_scores(PositionMoments(mean, covariance), log_weight, truth, valid, Blocks())
    (slope,) = torch.autograd.grad(scores.energy.sum(), mean)
    assert (slope[:, 2] == 0).all()
    assert (slope[:, :2] != 0).any()


def test_without_a_compiler_rows_are_left_to_tensors(monkeypatch):
    monkeypatch.setattr(blocks, "library", lambda dtype: None)
    assert not Blocks().fit(torch.zeros(2, 3))
    made = ControlDecoder(SingleIntegrator(dt_s=0.1), 2, 1, 3, hidden=3, blocks=Blocks())
    assert made._controls(*rows(2, made, torch.float32))[0].shape == (2, 3, 2)
