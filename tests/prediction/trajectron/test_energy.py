"""The energy score of a mixture of paths, as a loss."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch.autograd import gradcheck

from diffstack_mmv.geometry import rotate
from diffstack_mmv.prediction.trajectron.energy import energy_of_paths


def mixture(batch=3, components=4, steps=5):
    draw = torch.Generator().manual_seed(2)
    log_weight = torch.randn(batch, components, generator=draw, dtype=torch.float64)
    mean = 2 * torch.randn(batch, components, steps, 2, generator=draw, dtype=torch.float64)
    truth = torch.randn(batch, steps, 2, generator=draw, dtype=torch.float64)
    return log_weight.log_softmax(-1), mean, truth, torch.ones(batch, steps, dtype=torch.bool)


def test_a_single_path_scores_its_mean_distance_over_the_valid_times():
    log_weight, mean, truth, valid = mixture(components=1)
    valid[0, 2:] = False
    distance = (mean[:, 0] - truth).norm(dim=-1)
    score = energy_of_paths(torch.zeros_like(log_weight), mean, truth, valid)
    assert score[0] == pytest.approx(float(distance[0, :2].mean()))
    assert score[1].item() == pytest.approx(float(distance[1].mean()))


def test_it_is_the_definition_with_all_pairs():
    log_weight, mean, truth, valid = mixture()
    weight = log_weight.exp()
    missed = (mean - truth.unsqueeze(1)).norm(dim=-1).mean(-1)
    apart = (mean.unsqueeze(1) - mean.unsqueeze(2)).norm(dim=-1).mean(-1)
    expected = (weight * missed).sum(-1)
    expected = expected - 0.5 * torch.einsum("bk,bkl,bl->b", weight, apart, weight)
    torch.testing.assert_close(energy_of_paths(log_weight, mean, truth, valid), expected)


def test_gradients_and_components_that_do_not_count():
    log_weight, mean, truth, valid = mixture()
    log_weight[:, 0] = log_weight[:, 1] = log_weight[:, 2] = 0.0
    log_weight[:, 3] = -9.0
    inputs = log_weight.log_softmax(-1).requires_grad_(), mean[:, :3].requires_grad_()

    def score(log_weight, mean):
        return energy_of_paths(log_weight[:, :3], mean, truth, valid)

    assert gradcheck(score, inputs)
    everybody = mean.detach().requires_grad_()
    energy_of_paths(inputs[0], everybody, truth, valid).sum().backward()
    assert (everybody.grad[:, 3] == 0).all()
    assert (everybody.grad[:, :3] != 0).any()


@pytest.mark.parametrize("where", ["on the truth", "all alike", "nothing valid"])
def test_values_and_gradients_are_finite(where):
    log_weight, mean, truth, valid = mixture()
    if where == "on the truth":
        mean = truth.unsqueeze(1).expand_as(mean).clone()
    if where == "all alike":
        mean = mean[:, :1].expand_as(mean).clone()
    if where == "nothing valid":
        valid = torch.zeros_like(valid)
    mean.requires_grad_()
    score = energy_of_paths(log_weight, mean, truth, valid)
    score.sum().backward()
    assert score.isfinite().all()
    assert mean.grad.isfinite().all()
    if where != "all alike":
        assert score.detach() == pytest.approx(torch.zeros(3).numpy(), abs=1e-5)


@given(share=st.floats(0.0, 1.0), angle=st.floats(-3.0, 3.0))
def test_it_is_proper_and_does_not_depend_on_the_frame(share, angle):
    """Two places, the truth in the first with 0.7: no other weight has a lower mean score."""
    mean = torch.tensor([[[[0.0, 0.0]], [[3.0, 1.0]]]], dtype=torch.float64)
    turned = rotate(mean, torch.tensor(angle, dtype=torch.float64)) + 5.0
    valid = torch.ones(1, 1, dtype=torch.bool)

    def expected(first, paths):
        weight = torch.tensor([[first, 1 - first]], dtype=torch.float64).clamp_min(1e-9).log()
        each = [float(energy_of_paths(weight, paths, paths[:, k], valid)) for k in (0, 1)]
        return 0.7 * each[0] + 0.3 * each[1]

    assert expected(share, mean) >= expected(0.7, mean) - 1e-9
    assert expected(share, turned) == pytest.approx(expected(share, mean), abs=1e-9)
