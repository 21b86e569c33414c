"""Displacement metrics against plain loops."""

import math

import pytest
import torch

from diffstack_mmv.metrics.displacement import (
    AverageDisplacement,
    FinalDisplacement,
    MinimumDisplacement,
    MissRate,
    average_displacement,
    best_average_displacement,
    final_displacement,
)
from diffstack_mmv.types import Forecast, Mode, Motion, Tracks

METRICS = [AverageDisplacement, FinalDisplacement, MinimumDisplacement, MissRate]


def sample(batch=6, components=4, steps=5):
    """A random forecast, and a truth with gaps."""
    scale = 0.5 * torch.eye(2).expand(batch, components, steps, 2, 2)
    weight = torch.randn(batch, components).log_softmax(-1)
    forecast = Forecast(weight, torch.randn(batch, components, steps, 2), scale)
    zero = torch.zeros(batch, steps)
    motion = Motion(torch.randn(batch, steps, 2), zero, torch.zeros(batch, steps, 2), zero)
    valid = torch.rand(batch, steps) < 0.7
    valid[0] = True
    valid[1] = False
    mode = torch.full((batch,), int(Mode.BICYCLE))
    return forecast, Tracks(motion, torch.ones(batch, 2), mode, valid)


def looped(path, future, row):
    """ADE of one sample, written as a loop."""
    distances = [
        math.dist(path[row, t].tolist(), future.motion.position[row, t].tolist())
        for t in range(path.shape[1])
        if future.valid[row, t]
    ]
    return sum(distances) / len(distances) if distances else math.nan


def test_average_displacement_equals_a_loop():
    forecast, future = sample()
    found = average_displacement(forecast.most_likely(), future)
    expected = [looped(forecast.most_likely(), future, row) for row in range(6)]
    assert found.tolist() == pytest.approx(expected, rel=1e-5, nan_ok=True)


def test_best_displacement_is_that_of_the_best_of_the_heaviest_components():
    forecast, future = sample()
    found = best_average_displacement(forecast, future, 2)
    for row in (0, 2, 3):
        heaviest = forecast.log_weight[row].argsort(descending=True)[:2]
        expected = min(looped(forecast.mean[:, k], future, row) for k in heaviest)
        assert float(found[row]) == pytest.approx(expected, rel=1e-5)


def test_best_of_one_component_is_the_most_likely_one():
    forecast, future = sample()
    alone = average_displacement(forecast.most_likely(), future)
    assert torch.allclose(best_average_displacement(forecast, future, 1), alone, equal_nan=True)


def test_final_displacement_needs_the_last_position():
    forecast, future = sample()
    found = final_displacement(forecast.most_likely(), future)
    assert torch.equal(torch.isnan(found), ~future.valid[:, -1])


@pytest.mark.parametrize("metric", METRICS)
def test_metric_over_batches_equals_the_mean_over_samples(metric):
    parts, whole = metric(), metric()
    batches = [sample(batch=size) for size in (2, 5, 3)]
    for batch in batches:
        parts.update(*batch)
    scores = torch.cat([whole.scores(*batch) for batch in batches])
    assert torch.allclose(parts.compute(), scores[~torch.isnan(scores)].mean())


@pytest.mark.parametrize("metric", METRICS)
def test_states_of_two_processes_add_up(metric):
    first, second, together = metric(), metric(), metric()
    batches = [sample(batch=2), sample(batch=5)]
    first.update(*batches[0])
    second.update(*batches[1])
    for batch in batches:
        together.update(*batch)
    assert all(first._reductions[name] is not None for name in ("total", "count"))
    first.total, first.count = first.total + second.total, first.count + second.count
    assert torch.allclose(first.compute(), together.compute())


def test_miss_rate_counts_ends_beyond_the_limit():
    forecast, future = sample()
    forecast = forecast._replace(
        mean=future.motion.position.unsqueeze(1).expand_as(forecast.mean).clone()
    )
    forecast.mean[0, :, -1] += 3.0
    metric = MissRate(limit_m=2.0)
    metric.update(forecast, future)
    assert float(metric.compute()) == pytest.approx(1 / int(future.valid[:, -1].sum()))


@pytest.mark.parametrize("metric", METRICS)
def test_every_metric_names_its_unit_and_direction(metric):
    assert metric.unit in ("m", "1")
    assert metric.title
    assert metric.higher_is_better is False


def test_impossible_options_are_refused():
    with pytest.raises(ValueError, match="`components` must be at least 1"):
        MinimumDisplacement(0)
    with pytest.raises(ValueError, match="`limit_m` must be positive"):
        MissRate(0.0)
