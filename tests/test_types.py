"""Records: forecasts, statuses, and mapping over their tensors."""

import pytest
import torch
from torch.autograd import gradcheck
from torch.distributions import Categorical, MixtureSameFamily, MultivariateNormal

from diffstack_mmv.types import (
    Bounds,
    Forecast,
    Obstacles,
    SolverStatus,
    log_density,
    map_tensors,
    taken,
)
from tests.prediction.samples import scene


def example_forecast(batch=(3,), components=4, steps=5):
    factor = torch.randn(*batch, components, steps, 2, 2).tril()
    scale = factor.tril(-1) + torch.diag_embed(factor.diagonal(dim1=-2, dim2=-1).abs() + 0.1)
    weight = torch.randn(*batch, components).log_softmax(-1)
    return Forecast(weight, torch.randn(*batch, components, steps, 2), scale)


def test_forecast_density_agrees_with_torch_distributions():
    forecast = example_forecast()
    position = torch.randn(3, 5, 2)
    for t in range(5):
        mixture = MixtureSameFamily(
            Categorical(logits=forecast.log_weight),
            MultivariateNormal(
                forecast.mean[..., t, :], scale_tril=forecast.scale_tril[..., t, :, :]
            ),
        )
        expected = mixture.log_prob(position[:, t])
        assert torch.allclose(forecast.log_prob(position)[:, t], expected, atol=1e-4)


def test_density_equals_that_of_torch_distributions():
    factor = torch.randn(5, 2, 2, dtype=torch.float64).tril()
    factor.diagonal(dim1=-2, dim2=-1).exp_()
    error = torch.randn(5, 2, dtype=torch.float64)
    expected = MultivariateNormal(torch.zeros(2).double(), scale_tril=factor).log_prob(error)
    assert torch.allclose(log_density(error, factor), expected, rtol=1e-12)


def test_density_has_the_gradient_of_its_value():
    factor = torch.tensor([[[0.5, 0.0], [-0.3, 2.0]]], dtype=torch.float64, requires_grad=True)
    error = torch.tensor([[0.7, -1.1], [0.0, 0.0]], dtype=torch.float64, requires_grad=True)
    assert gradcheck(log_density, (error, factor))


def test_most_likely_path_is_that_of_the_heaviest_component():
    forecast = example_forecast()
    best = forecast.log_weight.argmax(-1)
    for i in range(3):
        assert torch.equal(forecast.most_likely()[i], forecast.mean[i, best[i]])


def test_expected_path_is_the_mean_of_the_mixture():
    forecast = example_forecast()
    mixture = MixtureSameFamily(
        Categorical(logits=forecast.log_weight),
        MultivariateNormal(
            forecast.mean[..., -1, :], scale_tril=forecast.scale_tril[..., -1, :, :]
        ),
    )
    assert torch.allclose(forecast.expected()[:, -1], mixture.mean, atol=1e-5)


def test_median_path_follows_the_majority_and_its_gradient_reaches_all_weights():
    ends = torch.tensor([[0.0, 0.0], [0.1, 0.0], [10.0, 0.0]])
    weight = torch.tensor([0.4, 0.3, 0.3], requires_grad=True)
    mean = ends.unsqueeze(1).expand(3, 5, 2)
    forecast = Forecast(weight.log(), mean, torch.eye(2).expand(3, 5, 2, 2))
    median = forecast.median(iterations=50)
    assert (median[:, 0] >= 0).all()
    assert (median[:, 0] <= 0.11).all()
    median.sum().backward()
    assert (weight.grad != 0).all()
    alone = Forecast(torch.zeros(1), mean[2:], forecast.scale_tril[2:])
    assert torch.equal(alone.median(), mean[2])


def test_components_that_hardly_count_get_no_gradient_from_the_median():
    weight = torch.tensor([0.495, 0.495, 0.01]).log()
    mean = torch.tensor([0.0, 1.0, 5.0])[:, None, None].repeat(1, 4, 2).requires_grad_()
    scale = torch.eye(2).expand(3, 4, 2, 2)
    Forecast(weight, mean, scale).median().sum().backward()
    reached = mean.grad.abs().amax((1, 2)) > 0
    assert reached.tolist() == [True, True, False]


@pytest.mark.parametrize("batch", [(4,), (2, 4)])
def test_the_median_of_a_forecast_does_not_depend_on_those_beside_it(batch):
    """As many forecasts as components: a sum over the wrong ones would have the right shape."""
    forecast = example_forecast(batch)
    together = forecast.median().reshape(-1, 5, 2)
    single = Forecast(*(entry.flatten(0, len(batch) - 1) for entry in forecast))
    for row, path in enumerate(together):
        alone = Forecast(*(entry[row] for entry in single)).median()
        torch.testing.assert_close(path, alone)


@pytest.mark.parametrize("agents", ["ego_past", "neighbors_past"])
def test_the_present_is_the_last_row_of_every_field(agents):
    tracks = getattr(scene(batch=(2,), neighbors=3), agents)
    tracks.valid[..., -1].flatten()[0] = False
    now = tracks.present()
    leading = tracks.mode.shape
    assert now.valid.shape == leading
    assert torch.equal(now.valid, tracks.valid[..., -1])
    assert torch.equal(now.motion.position, tracks.motion.position[..., -1, :])
    assert torch.equal(now.motion.velocity, tracks.motion.velocity[..., -1, :])
    assert torch.equal(now.motion.heading, tracks.motion.heading[..., -1])
    assert torch.equal(now.motion.yaw_rate, tracks.motion.yaw_rate[..., -1])


def test_whoever_is_not_valid_has_zeros_for_all_numbers():
    valid = torch.tensor([[True, False], [False, True]])
    position, weight = torch.ones(2, 2, 3, 4, 2), torch.ones(2, 2, 3)
    radius = torch.ones(2, 2)
    for entry in (position, weight, radius):
        entry[~valid] = torch.nan
    kept = Obstacles(position, weight, radius, valid).of_valid()
    for entry in kept[:3]:
        assert (entry[valid] == 1).all()
        assert (entry[~valid] == 0).all()


def test_mapping_reaches_every_tensor_and_keeps_the_rest():
    record = (Bounds(torch.zeros(2), torch.ones(2)), 0.1)
    mapped = map_tensors(lambda tensor: tensor + 1, record[0])
    assert isinstance(mapped, Bounds)
    assert torch.equal(mapped.upper, torch.full((2,), 2.0))
    assert map_tensors(torch.neg, record[1]) == 0.1


def test_mapping_several_records_meets_the_same_field_of_each():
    first, second = ((torch.tensor(n), None, (torch.tensor(n + 1), "m")) for n in (1, 10))
    found = map_tensors(lambda *entries: sum(entries), first, second, second)
    assert found == (21, None, (24, "m"))
    with pytest.raises(ValueError, match="shorter"):
        map_tensors(torch.add, first, second[:2])


def test_entries_are_taken_from_every_tensor_by_their_numbers():
    forecast, index = example_forecast(), torch.tensor([[2, 0], [3, 3], [1, 2]])
    found = taken(forecast, index)
    for field, entries in zip(forecast, found, strict=True):
        expected = torch.stack([field[i, index[i]] for i in range(3)])
        assert torch.equal(entries, expected)


def test_the_likeliest_component_keeps_its_weight_and_its_scale():
    forecast = example_forecast()
    alone, best = forecast.likeliest(), forecast.log_weight.argmax(-1)
    assert torch.equal(alone.log_weight.squeeze(-1), forecast.log_weight.amax(-1))
    for i in range(3):
        assert torch.equal(alone.scale_tril[i, 0], forecast.scale_tril[i, best[i]])


@pytest.mark.parametrize("status", list(SolverStatus))
def test_every_status_comes_with_advice(status):
    assert status.advice.endswith(".")
