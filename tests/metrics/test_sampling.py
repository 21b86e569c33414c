"""Paths drawn from a forecast, and the best of them."""

import math

import pytest
import torch

from diffstack_mmv.metrics import (
    best_of_samples,
    coverages,
    energy_score,
    judged_levels,
    sampled_paths,
    spread_paths,
)
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


@pytest.mark.parametrize(("name", "draw"), [("", sampled_paths), ("_spread", spread_paths)])
def test_the_best_of_twenty_is_the_nearest_of_twenty_paths(name, draw):
    forecast, truth = forecast_of(3), torch.randn(3, 6, 2)
    found = best_of_samples(forecast, future_of(truth), seed=4, first=7)
    paths = draw(forecast, count=20, seed=4, first=7)
    for row in range(3):
        away = [
            [math.dist(path[t].tolist(), truth[row, t].tolist()) for t in range(6)]
            for path in paths[row]
        ]
        ade, fde = min(sum(each) / 6 for each in away), min(each[-1] for each in away)
        assert found[f"best_of_20{name}_ade"][row].item() == pytest.approx(ade, rel=1e-5)
        assert found[f"best_of_20{name}_fde"][row].item() == pytest.approx(fde, rel=1e-5)


@pytest.mark.parametrize("draw", [sampled_paths, spread_paths])
def test_the_last_of_twenty_paths_is_one_of_them(draw):
    forecast = forecast_of(3)
    best = best_of_samples(forecast, future_of(draw(forecast, count=20)[:, 19]))
    name = "best_of_20_ade" if draw is sampled_paths else "best_of_20_spread_ade"
    assert best[name].max() < 1e-6


def test_times_that_were_not_recorded_do_not_count():
    forecast = forecast_of()
    future = future_of(forecast.mean[:, 0])
    future.valid[0, 3:] = False
    best = best_of_samples(forecast, future)
    assert best["best_of_20_ade"].isfinite().all()
    assert best["best_of_20_fde"].isnan().tolist() == [True, False]


@pytest.mark.parametrize("draw", [sampled_paths, spread_paths])
def test_draws_belong_to_the_forecast_and_not_to_its_batch(draw):
    forecast = forecast_of(count=5)
    together = draw(forecast)
    for row in range(5):
        alone = Forecast(*(entry[row : row + 1] for entry in forecast))
        assert torch.equal(draw(alone, first=row)[0], together[row])
    assert not torch.equal(together[0], together[1])
    assert not torch.equal(draw(forecast, seed=1)[0], together[0])


@pytest.mark.parametrize("draw", [sampled_paths, spread_paths])
@pytest.mark.parametrize("shape", [(), (2, 3), (3, 1, 2)])
def test_a_grid_of_forecasts_has_the_draws_of_a_row(draw, shape) -> None:
    row = forecast_of(count=max(math.prod(shape), 1))
    grid = Forecast(*(entry.reshape(*shape, *entry.shape[1:]) for entry in row))
    paths = draw(grid, count=7, seed=3, first=5)
    assert paths.shape == (*shape, 7, 6, 2)
    torch.testing.assert_close(paths.reshape(-1, 7, 6, 2), draw(row, count=7, seed=3, first=5))


def gaussian(spread, count=3000, steps=2):
    """Many equal forecasts around the origin."""
    return Forecast(
        torch.zeros(count, 1),
        torch.zeros(count, 1, steps, 2),
        spread * torch.eye(2).expand(count, 1, steps, 2, 2),
    )


@pytest.mark.parametrize("offset", [0.0, 0.7])
def test_the_energy_score_of_a_gaussian_is_the_closed_form(offset):
    """Of one that is as wide as it should be: σ √π (1 - 1/2) in two dimensions; a sure one: |y|."""
    future = future_of(torch.tensor([offset, 0.0]).expand(3000, 2, 2))
    assert torch.allclose(energy_score(gaussian(1e-6), future), torch.tensor(offset), atol=1e-4)
    if offset == 0:
        at_the_mean = math.sqrt(math.pi / 2) - math.sqrt(math.pi) / 2
        assert abs(energy_score(gaussian(1.0), future).mean() - at_the_mean) < 0.02


def test_an_energy_score_of_one_draw_is_refused():
    """It has no pair to be compared: the score was NaN, as if nothing were known of the truth."""
    with pytest.raises(ValueError, match="`count` must be at least 2, but got 1"):
        energy_score(gaussian(1.0, 1), future_of(torch.zeros(1, 2, 2)), count=1)


def test_no_forecast_has_a_better_energy_score_than_the_truth():
    drawn = torch.randn(3000, 2, 2, generator=torch.Generator().manual_seed(1))
    true, narrow, wide = (
        energy_score(gaussian(spread), future_of(drawn)).mean() for spread in (1.0, 0.5, 2.0)
    )
    assert true < min(narrow, wide) - 0.02


def test_the_energy_score_leaves_out_what_was_not_recorded():
    forecast = forecast_of()
    future = future_of(forecast.mean[:, 0])
    future.valid[0, 3:], future.valid[1] = False, False
    assert energy_score(forecast, future).isnan().tolist() == [False, True]


def test_each_spread_path_is_distributed_as_if_drawn_alone():
    paths = spread_paths(forecast_of(count=3000), count=4)
    straight = paths[:, 0, -1, 0] > paths[:, 0, -1, 1]
    assert abs(straight.float().mean() - 0.25) < 0.03
    deviation = paths[straight, 0].std(0)
    expected = 0.1 * torch.arange(1.0, 7.0).unsqueeze(-1).expand(-1, 2)
    assert torch.allclose(deviation, expected, rtol=0.15)


def test_spread_paths_are_shared_out_by_weight_and_lie_apart():
    forecast = forecast_of(count=500)
    both = [draw(forecast, 20) for draw in (sampled_paths, spread_paths)]
    straight = [(p[..., -1, 0] > p[..., -1, 1]).sum(-1).double() for p in both]
    assert straight[1].std() < 0.5 * straight[0].std()
    noise = torch.randn(500, 6, 2, generator=torch.Generator().manual_seed(0))
    drawn = forecast.mean[:, 0] + 0.1 * noise
    best = best_of_samples(forecast, future_of(drawn))
    assert best["best_of_20_spread_ade"].mean() < best["best_of_20_ade"].mean()


def test_spread_paths_leave_out_what_is_impossible():
    forecast = forecast_of(count=50)
    log_weight = torch.tensor([-torch.inf, 0.0]).expand(50, 2)
    paths = spread_paths(Forecast(log_weight, forecast.mean, forecast.scale_tril), 20)
    assert (paths[..., -1, 1] > paths[..., -1, 0]).all()
    assert paths.isfinite().all()


@pytest.mark.parametrize("angle", [0.5, 1.6, -0.7])
def test_the_best_of_many_is_the_same_in_a_turned_scene(angle):
    count, time = 3000, torch.linspace(0.3, 3.0, 6)
    course = 0.5 * time
    along = torch.stack([course.cos(), course.sin()], -1)
    across = torch.stack([-course.sin(), course.cos()], -1)
    axes = torch.stack([0.9 * time[:, None] * along, 0.3 * time[:, None] * across], -1)
    noise = torch.randn(count, 1, 2, 1, generator=torch.Generator().manual_seed(0))
    truth = (axes @ noise).squeeze(-1)
    turn = torch.tensor([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])

    def best(frame):
        covariance = frame @ axes @ axes.mT @ frame.mT
        scale = torch.linalg.cholesky(covariance).expand(count, 1, 6, 2, 2)
        forecast = Forecast(torch.zeros(count, 1), torch.zeros(count, 1, 6, 2), scale)
        return best_of_samples(forecast, future_of(truth @ frame.mT))

    plain, turned = best(torch.eye(2)), best(turn)
    for name in ("best_of_20_ade", "best_of_20_fde"):
        value = plain[name]
        assert turned[name].mean().item() == pytest.approx(value.mean().item(), rel=0.04)


@pytest.mark.parametrize(
    "score",
    [
        energy_score,
        lambda forecast, future: best_of_samples(forecast, future)["best_of_20_spread_fde"],
        lambda forecast, future: coverages(judged_levels(forecast, future))["coverage_50"],
        lambda forecast, future: coverages(judged_levels(forecast, future))["area_90"],
    ],
)
def test_of_no_forecast_there_is_no_score(score):
    assert score(forecast_of(0), future_of(torch.zeros(0, 6, 2))).shape == (0,)
