"""Likelihood metrics."""

import math

import pytest
import torch

from diffstack_mmv.metrics import masked_mean, negative_log_likelihood
from diffstack_mmv.types import Forecast
from tests.metrics.samples import sample, tracks


def standard(offset, steps=4, batch=2):
    """Two equal standard Gaussians at the origin, and a truth at an offset in m from them."""
    mean = torch.zeros(batch, 2, steps, 2)
    forecast = Forecast(
        torch.full((batch, 2), math.log(0.5)), mean, torch.eye(2).expand(*mean.shape, 2)
    )
    position = torch.tensor([offset, 0.0]).expand(batch, steps, 2)
    return forecast, tracks(position, torch.ones(batch, steps, dtype=torch.bool))


@pytest.mark.parametrize("offset", [0.0, 1.0, 3.0])
def test_likelihood_of_a_standard_gaussian(offset):
    expected = math.log(2 * math.pi) + 0.5 * offset**2
    found = negative_log_likelihood(*standard(offset))
    assert found.tolist() == pytest.approx([expected, expected], rel=1e-5)


def test_log_probability_is_floored():
    assert negative_log_likelihood(*standard(100.0)).tolist() == [20.0, 20.0]


def test_times_that_are_not_valid_do_not_count():
    forecast, future = standard(1.0)
    spoiled = future.motion.position.clone()
    spoiled[:, 2:] = 50.0
    valid = future.valid.clone()
    valid[:, 2:] = False
    partial = future._replace(motion=future.motion._replace(position=spoiled), valid=valid)
    assert torch.allclose(
        negative_log_likelihood(forecast, partial), negative_log_likelihood(forecast, future)
    )


def test_likelihood_equals_a_loop_over_mixture_and_times():
    forecast, future = sample()
    found = negative_log_likelihood(forecast, future)
    assert math.isnan(found[1])
    for row in (0, 2, 3):
        total = 0.0
        for t in future.valid[row].nonzero().flatten():
            gaussians = torch.distributions.MultivariateNormal(
                forecast.mean[row, :, t], scale_tril=forecast.scale_tril[row, :, t]
            )
            log_prob = gaussians.log_prob(future.motion.position[row, t])
            total -= max(float((forecast.log_weight[row] + log_prob).logsumexp(0)), -20.0)
        assert float(found[row]) == pytest.approx(total / int(future.valid[row].sum()), rel=1e-4)


def test_gradient_is_finite_beside_the_unknown():
    forecast, future = sample()
    mean = forecast.mean.clone().requires_grad_()
    found = negative_log_likelihood(forecast._replace(mean=mean), future)
    masked_mean(found, future.valid.any(-1)).backward()
    assert torch.isfinite(mean.grad).all()
    assert (mean.grad[1] == 0).all()
