"""Likelihood metrics."""

import math

import pytest
import torch

from diffstack_mmv.metrics.likelihood import NegativeLogLikelihood, negative_log_likelihood
from diffstack_mmv.types import Forecast, Mode, Motion, Tracks


def standard(offset, steps=4, batch=2):
    """Two equal standard Gaussians at the origin, and a truth at an offset in m from them."""
    mean = torch.zeros(batch, 2, steps, 2)
    forecast = Forecast(
        torch.full((batch, 2), math.log(0.5)), mean, torch.eye(2).expand(*mean.shape, 2)
    )
    zero = torch.zeros(batch, steps)
    position = torch.tensor([offset, 0.0]).expand(batch, steps, 2)
    motion = Motion(position, zero, torch.zeros(batch, steps, 2), zero)
    valid = torch.ones(batch, steps, dtype=torch.bool)
    return forecast, Tracks(
        motion, torch.ones(batch, 2), torch.full((batch,), int(Mode.BICYCLE)), valid
    )


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


def test_metric_is_the_mean_over_samples_with_any_valid_time():
    metric = NegativeLogLikelihood()
    forecast, future = standard(1.0)
    valid = future.valid.clone()
    valid[0] = False
    metric.update(forecast, future._replace(valid=valid))
    metric.update(*standard(0.0))
    assert float(metric.compute()) == pytest.approx(math.log(2 * math.pi) + 0.5 / 3, rel=1e-5)
