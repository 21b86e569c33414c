"""The discrete latent variable."""

import pytest
import torch
from torch.distributions import Categorical, kl_divergence

from diffstack_mmv.prediction import Annealing
from diffstack_mmv.prediction.trajectron.latent import Latent, divergence


def test_divergence_equals_that_of_torch_distributions():
    q, p = torch.randn(5, 7).log_softmax(-1), torch.randn(5, 7).log_softmax(-1)
    expected = kl_divergence(Categorical(logits=q), Categorical(logits=p))
    assert torch.allclose(divergence(q, p), expected, atol=1e-6)


@pytest.mark.parametrize(("name", "sizes"), [("log_prior", [6]), ("log_posterior", [6, 4])])
def test_prior_and_posterior_are_normalised(name, sizes):
    judge = getattr(Latent(6, 4, 5), name)
    found = judge(*(torch.randn(3, size) for size in sizes))
    assert torch.allclose(found.exp().sum(-1), torch.ones(3))


def test_free_nats_cost_nothing_and_pull_nowhere():
    small = torch.tensor([0.0, 0.05], requires_grad=True)
    penalty = Annealing().penalty(small, torch.tensor(10000))
    penalty.sum().backward()
    assert penalty.tolist() == [0.0, 0.0]
    assert small.grad.tolist() == [0.0, 0.0]


def test_penalty_rises_to_its_weight_and_is_half_of_it_at_the_crossover():
    annealing = Annealing(weight=10.0, crossover_steps=100, free_nats=0.0)
    penalties = [
        float(annealing.penalty(torch.ones(()), torch.tensor(step))) for step in (0, 100, 1000)
    ]
    assert penalties[0] < 0.2
    assert penalties[1:] == pytest.approx([5.0, 10.0])


@pytest.mark.parametrize("options", [{"weight": -1.0}, {"crossover_steps": 0}, {"free_nats": -0.1}])
def test_impossible_annealing_is_refused(options):
    with pytest.raises(ValueError, match=f"`annealing.{next(iter(options))}` must"):
        Annealing(**options)
