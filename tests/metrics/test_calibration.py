"""Coverage is that of the forecast that made the truths, and tells one that is too sure."""

import math

import pytest
import torch

from diffstack_mmv.metrics import Calibration, coverages, judged_levels
from diffstack_mmv.metrics.calibration import DensityLevels, drawn_densities
from diffstack_mmv.types import Forecast, map_tensors
from tests.stack.test_module import straight_tracks


def forecast(batch, components=1, times=6, scale=1.0):
    roots = scale * torch.tensor([[1.0, 0.0], [0.5, 2.0]])
    mean = 10.0 * torch.arange(components).reshape(-1, 1, 1).expand(batch, components, times, 2)
    weight = torch.full((batch, components), -math.log(components))
    return Forecast(weight, mean.clone(), roots.expand(batch, components, times, 2, 2))


@pytest.mark.parametrize("distance", [0.3, 1.0, 2.0])
def test_level_of_one_gaussian_is_that_of_its_ellipse(distance):
    one = forecast(2)
    position = torch.tensor([0.6, 0.8]) * distance @ one.scale_tril[0, 0, 0].T
    future = straight_tracks(position.expand(2, 2), torch.zeros(2, 2), 6, 0)
    found = judged_levels(one, future, samples=4000)
    expected = 1 - math.exp(-0.5 * distance**2)
    assert found.level.mean().item() == pytest.approx(expected, abs=0.01)


def test_beyond_all_samples_a_level_counts_the_nats_below_the_least_dense_of_them():
    one = forecast(2)
    position = torch.tensor([0.0, 8.0]) @ one.scale_tril[0, 0, 0].T
    future = straight_tracks(position.expand(2, 2), torch.zeros(2, 2), 6, 0)
    found = judged_levels(one, future)
    own = -0.5 * 8**2 - math.log(2 * math.pi * 2.0)  # the determinant of the root is 2
    torch.testing.assert_close(found.level, 1 + found.drawn.amin(-2) - own, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize(
    ("scale", "low", "high"), [(1.0, 0.46, 0.54), (0.5, 0.0, 0.3), (2.0, 0.7, 1)]
)
def test_coverage_tells_a_forecast_that_is_too_sure_or_not_sure_enough(scale, low, high):
    torch.manual_seed(0)
    count = 400
    truth = forecast(count, components=2)
    drawn = truth.mean[torch.arange(count), torch.randint(2, (count,))]
    noise = torch.randn(count, 6, 2)
    future = straight_tracks(torch.zeros(count, 2), torch.ones(count, 2), 6, 0)
    position = drawn + noise @ truth.scale_tril[0, 0, 0].T
    future = future._replace(motion=future.motion._replace(position=position))
    found = coverages(judged_levels(forecast(count, components=2, scale=scale), future))
    assert low <= found["coverage_50"].mean().item() <= high
    assert (found["coverage_90"] >= found["coverage_50"]).all()


def test_who_has_no_future_is_not_judged():
    future = straight_tracks(torch.zeros(2, 2), torch.ones(2, 2), 6, 0)
    future = future._replace(valid=torch.tensor([[True] * 6, [False] * 6]))
    found = coverages(judged_levels(forecast(2), future))
    assert found["coverage_50"].isnan().tolist() == [False, True]


def truths_of(count, seed):
    torch.manual_seed(seed)
    future = straight_tracks(torch.zeros(count, 2), torch.ones(count, 2), 6, 0)
    position = torch.randn(count, 6, 2) @ forecast(1).scale_tril[0, 0, 0].T
    return future._replace(motion=future.motion._replace(position=position))


@pytest.mark.parametrize("scale", [0.6, 1.0, 3.0])
def test_conformal_levels_hold_what_they_should_on_other_samples(scale):
    count = 600
    sure = forecast(count, scale=scale)
    held_out = judged_levels(sure, truths_of(count, 1))
    calibration = Calibration.fitted(held_out.level, held_out.valid)
    found = coverages(judged_levels(sure, truths_of(count, 2)), calibration)
    for region in (50, 90):
        assert found[f"coverage_{region}"].mean().item() == pytest.approx(region / 100, abs=0.05)


def test_area_of_a_gaussian_region_is_that_of_its_ellipse():
    levels = judged_levels(forecast(4), truths_of(4, 0), samples=4000)
    area = levels.area(torch.tensor([0.5]))
    expected = math.pi * 2 * math.log(2) * 2.0  # determinant of the root is 2
    assert area.mean().item() == pytest.approx(expected, rel=0.05)


def test_without_held_out_truths_a_region_is_the_whole_plane():
    nobody = torch.zeros(0, 2)
    assert Calibration.fitted(nobody, nobody > 0).levels.isinf().all()


@pytest.mark.parametrize(("count", "ranks"), [(9, (5, 9)), (10, (6, 10)), (19, (10, 18))])
def test_the_level_of_a_region_is_the_rank_of_split_conformal(count, ranks):
    levels = torch.arange(1.0, count + 1).flip(0)[:, None]
    assert Calibration.fitted(levels, levels > 0).levels[:, 0].tolist() == list(ranks)


def apart(count, times):
    """Two components far from each other and from the origin, unlike in weight, size and time."""
    weight = torch.tensor([0.8, 0.2])
    roots = torch.tensor([[[0.5, 0.0], [0.3, 1.5]], [[2.0, 0.0], [-1.0, 0.7]]])
    centre = torch.tensor([[900.0, -400.0], [-700.0, 300.0]])[:, None, :]
    mean = centre + 50.0 * torch.arange(times)[:, None]
    root = roots[:, None].expand(2, times, 2, 2)
    return Forecast(
        weight.log().expand(count, 2),
        mean.expand(count, 2, times, 2),
        root.expand(count, 2, times, 2, 2),
    )


@pytest.mark.parametrize("count", [1, 9])
def test_log_densities_of_draws_have_the_negative_entropy_of_the_mixture_as_mean(count):
    weights, determinants = (0.8, 0.2), (0.5 * 1.5, 2.0 * 0.7)
    entropy = sum(
        weight * (1 + math.log(2 * math.pi) + math.log(determinant) - math.log(weight))
        for weight, determinant in zip(weights, determinants, strict=True)
    )
    drawn = drawn_densities(apart(count, 2), samples=4000, seed=0)
    assert drawn.shape == (count, 4000, 2)
    assert drawn.mean((0, 1)).tolist() == pytest.approx([-entropy] * 2, abs=0.07)


def test_every_third_truth_is_judged_by_the_forecast_of_its_own_time():
    one, judged = apart(3, 8), torch.tensor([2, 5])
    off = torch.full((3, 8, 2), 1e5)
    off[:, judged] = one.mean[:, 0, judged]
    known = torch.zeros(3, 8, dtype=torch.bool)
    known[:, judged] = True
    future = straight_tracks(torch.zeros(3, 2), torch.ones(3, 2), 8, 0)
    future = future._replace(motion=future.motion._replace(position=off), valid=known)
    found = judged_levels(one, future, samples=50)
    assert found.valid.tolist() == [[True, True]] * 3
    assert found.level.tolist() == [[0.0, 0.0]] * 3


@pytest.mark.parametrize("shape", [(2, 6), (3, 2, 2)])
def test_a_grid_of_forecasts_is_judged_as_a_row(shape) -> None:
    row, future = forecast(12, components=3), truths_of(12, 0)
    grids = map_tensors(lambda entry: entry.reshape(*shape, *entry.shape[1:]), (row, future))
    found, expected = judged_levels(*grids, samples=20), judged_levels(row, future, samples=20)
    torch.testing.assert_close(found.level.reshape(12, 2), expected.level)
    torch.testing.assert_close(found.drawn.reshape(12, 20, 2), expected.drawn)


@pytest.mark.parametrize(
    ("level", "area"),
    [
        (0.5, (1 + math.e) / 4),
        (0.6, (1 + math.e) / 4),
        (1.0, (1 + math.e + math.e**2 + math.e**4) / 4),
        (2.5, (1 + 1.5 / 4) * (1 + math.e + math.e**2 + math.e**4) / 4),
    ],
)
def test_beyond_all_samples_a_region_grows_in_proportion_to_the_nats(level, area):
    drawn = torch.tensor([-2.0, 0.0, -4.0, -1.0]).reshape(1, 4, 1)
    levels = DensityLevels(torch.zeros(1, 1), torch.ones(1, 1) > 0, drawn)
    assert levels.area(torch.tensor([level])).item() == pytest.approx(area, rel=1e-5)
