"""Paths drawn from a forecast, and the best of them."""

import torch

from diffstack_mmv.metrics import best_of_samples, sampled_paths
from diffstack_mmv.types import Forecast, Motion, Tracks


def forecast_of(count=2, steps=6):
    """Two components, straight on and to the left, the second three times as likely."""
    step = torch.arange(1.0, steps + 1).unsqueeze(-1)
    mean = torch.stack([step * torch.tensor([1.0, 0.0]), step * torch.tensor([0.0, 1.0])])
    scale = 0.1 * step.unsqueeze(-1) * torch.eye(2)
    weight = torch.tensor([0.25, 0.75]).log()
    return Forecast(
        weight.expand(count, 2), mean.expand(count, 2, -1, 2), scale.expand(count, 2, -1, 2, 2)
    )


def future_of(path):
    zero = torch.zeros(path.shape[:-1])
    motion = Motion(path, zero, torch.zeros_like(path), zero)
    extent, mode = torch.ones(*path.shape[:-2], 2), torch.zeros(path.shape[:-2]).long()
    return Tracks(motion, extent, mode, zero == 0)


def test_each_time_is_distributed_as_forecast():
    paths = sampled_paths(forecast_of(), count=4000)[0]
    straight = paths[:, -1, 0] > paths[:, -1, 1]
    assert abs(straight.float().mean() - 0.25) < 0.03
    for row in (0, 5):
        deviation = paths[straight, row].std(0)
        assert torch.allclose(deviation, torch.full((2,), 0.1 * (row + 1)), rtol=0.1)


def test_the_best_of_many_is_near_and_draws_are_repeatable():
    forecast = forecast_of()
    future = future_of(forecast.mean[:, 0])
    best = best_of_samples(forecast, future)
    assert best["best_of_20_ade"].shape == (2,)
    assert (best["best_of_20_ade"] <= best["best_of_20_fde"]).all()
    assert (best["best_of_20_fde"] < 1.0).all()
    again = best_of_samples(forecast, future)
    assert torch.equal(best["best_of_20_ade"], again["best_of_20_ade"])


def test_times_that_were_not_recorded_do_not_count():
    forecast = forecast_of()
    future = future_of(forecast.mean[:, 0])
    future.valid[0, 3:] = False
    best = best_of_samples(forecast, future)
    assert best["best_of_20_ade"].isfinite().all()
    assert best["best_of_20_fde"].isnan().tolist() == [True, False]
