"""A forecast that is told where it ends."""

import pytest
import torch

from diffstack_mmv.planning.conditional import given_end
from diffstack_mmv.types import Forecast

STEPS = 4


def two_ways(deviation=0.5):
    """Straight ahead or to the left, equally likely, surer at first than at the end."""
    share = torch.arange(1, STEPS + 1) / STEPS
    ends = torch.tensor([[8.0, 0.0], [6.0, 4.0]])
    mean = ends.unsqueeze(1) * share.unsqueeze(-1)
    scale = deviation * share[:, None, None] * torch.eye(2)
    return Forecast(torch.full((2,), 0.5).log(), mean, scale.expand(2, STEPS, 2, 2))


def test_every_component_ends_where_it_is_told_and_the_near_one_counts():
    forecast = two_ways()
    end = torch.tensor([6.2, 3.7])
    told = given_end(forecast, end)
    assert torch.allclose(told.mean[:, -1], end.expand(2, 2), atol=1e-5)
    assert told.log_weight.exp()[1] > 0.99
    assert torch.allclose(told.log_weight.exp().sum(), torch.tensor(1.0))
    assert (told.mean[:, 0] - forecast.mean[:, 0]).norm(dim=-1)[1] < 0.15


def test_where_a_component_ends_already_it_stays():
    forecast = two_ways()
    told = given_end(forecast, forecast.mean[0, -1])
    assert torch.allclose(told.mean[0], forecast.mean[0], atol=1e-6)
    widths = told.scale_tril.diagonal(dim1=-2, dim2=-1)
    assert widths.amin() >= 0.1
    assert torch.isfinite(told.log_prob(told.mean[0])).all()


def test_a_width_that_is_not_positive_is_refused():
    with pytest.raises(ValueError, match="`width_m` must be positive"):
        given_end(two_ways(), torch.zeros(2), width_m=0.0)
