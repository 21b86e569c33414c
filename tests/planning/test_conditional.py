"""A forecast that is told where it ends."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch.distributions import MultivariateNormal

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


def turning(angle, batch=5):
    """Paths along a circle, less sure along than across, in a frame turned by an angle in rad."""
    time = torch.linspace(0.3, 3.0, 10, dtype=torch.float64)
    course = 0.5 * time
    path = 8.0 * torch.stack([course.sin(), 1 - course.cos()], -1)
    along = torch.stack([course.cos(), course.sin()], -1)
    across = torch.stack([-course.sin(), course.cos()], -1)
    axes = torch.stack([0.9 * time[:, None] * along, 0.3 * time[:, None] * across], -1)
    frame = torch.tensor(
        [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]],
        dtype=torch.float64,
    )
    covariance = frame @ axes @ axes.mT @ frame.mT
    mean = (path @ frame.mT).expand(batch, 1, 10, 2)
    scale = torch.linalg.cholesky(covariance).expand(batch, 1, 10, 2, 2)
    return frame, Forecast(torch.zeros(batch, 1, dtype=torch.float64), mean, scale)


@given(st.floats(-3.1, 3.1))
def test_a_forecast_that_is_told_its_end_turns_with_the_frame(angle):
    (_, plain), (frame, turned) = turning(0.0), turning(angle)
    end = plain.mean[:, 0, -1] + torch.tensor([1.0, 0.5], dtype=torch.float64)
    told, other = given_end(plain, end), given_end(turned, end @ frame.mT)
    assert torch.allclose(other.mean, told.mean @ frame.mT, atol=1e-9)
    left = frame @ told.scale_tril @ told.scale_tril.mT @ frame.mT
    assert torch.allclose(other.scale_tril @ other.scale_tril.mT, left, atol=1e-9)


def test_a_forecast_that_is_told_its_end_is_that_of_linear_algebra():
    _, plain = turning(0.4, batch=2)
    aside = torch.arange(3.0).double()[:, None, None] * torch.tensor([0.2, -0.4]).double()
    mean, scale = plain.mean + aside, plain.scale_tril.expand(2, 3, 10, 2, 2)
    forecast = Forecast(torch.randn(2, 3).double().log_softmax(-1), mean, scale)
    end, covariance, floor = mean[:, 0, -1] + 0.5, scale @ scale.mT, 0.01 * torch.eye(2).double()
    told = given_end(forecast, end)
    values, vectors = torch.linalg.eigh(covariance)
    root = vectors * values.sqrt().unsqueeze(-2) @ vectors.mT
    share = torch.arange(1, 11).double()[:, None, None] / 10
    error = (end.unsqueeze(1) - mean[..., -1, :])[..., None, :, None]
    moved = share.sqrt() * root @ torch.linalg.solve(root[..., -1:, :, :], error)
    rest = torch.linalg.cholesky((1 - share) * covariance + floor)
    at_end = MultivariateNormal(mean[..., -1, :], covariance[..., -1, :, :] + floor)
    weight = forecast.log_weight + at_end.log_prob(end.unsqueeze(1))
    expected = Forecast(weight.log_softmax(-1), mean + moved.squeeze(-1), rest)
    torch.testing.assert_close(told, expected, rtol=1e-11, atol=1e-11)


def test_gradients_of_a_forecast_that_is_told_its_end():
    _, forecast = turning(0.4, batch=2)
    fields = [field.clone().requires_grad_() for field in forecast]
    end = forecast.mean[:, 0, -1] + 0.5

    def told(weight, mean, scale):
        return tuple(given_end(Forecast(weight, mean, scale.tril()), end))

    assert torch.autograd.gradcheck(told, fields)


def test_a_width_that_is_not_positive_is_refused():
    with pytest.raises(ValueError, match="`width_m` must be positive"):
        given_end(two_ways(), torch.zeros(2), width_m=0.0)
