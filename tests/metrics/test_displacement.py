"""Displacements against plain loops."""

import math

import pytest
import torch

from diffstack_mmv.metrics import (
    average_displacement,
    best_average_displacement,
    displacement_curve,
    displacements,
    final_displacement,
    masked_mean,
    mean_square_displacement,
    missed,
)
from diffstack_mmv.types import map_tensors
from tests.metrics.samples import sample, tracks


def distances(path, future, row):
    """Distances of one sample at its valid times, written as a loop."""
    return [
        math.dist(path[row, t].tolist(), future.motion.position[row, t].tolist())
        for t in range(path.shape[1])
        if future.valid[row, t]
    ]


def mean(values):
    return sum(values) / len(values) if values else math.nan


def final(values, future, row):
    return values[-1] if future.valid[row, -1] else math.nan


LOOPS = {
    average_displacement: lambda found, future, row: mean(found),
    final_displacement: final,
    mean_square_displacement: lambda found, future, row: mean([d**2 for d in found]),
    missed: lambda found, future, row: (
        float(found[-1] > 2.0) if future.valid[row, -1] else math.nan
    ),
}


@pytest.mark.parametrize("score", LOOPS, ids=lambda score: score.__name__)
def test_score_equals_a_loop_and_is_nan_where_a_sample_cannot_be_judged(score):
    forecast, future = sample(batch=40)
    path = 2 * forecast.most_likely()
    loop = LOOPS[score]
    expected = [loop(distances(path, future, row), future, row) for row in range(40)]
    found = score(path, future)
    assert found.tolist() == pytest.approx(expected, rel=1e-5, nan_ok=True)
    assert math.isnan(found[1])
    assert not math.isnan(found[0])


@pytest.mark.parametrize(
    ("score", "judged"),
    [(average_displacement, True), (mean_square_displacement, True), (final_displacement, False),
     (missed, False)],
    ids=lambda value: getattr(value, "__name__", str(value)),
)  # fmt: skip
def test_a_track_that_ends_early_has_an_average_but_no_final_score(score, judged):
    forecast, future = sample()
    assert bool(torch.isfinite(score(forecast.most_likely(), future)[2])) is judged


def test_displacement_over_the_horizon_is_known_at_valid_times():
    forecast, future = sample()
    path = forecast.most_likely()
    curve = displacement_curve(path, future)
    assert torch.equal(torch.isnan(curve), ~future.valid)
    told = displacements(path, future)
    assert torch.allclose(told["ade"], curve.nanmean(-1), equal_nan=True)
    assert torch.allclose(told["fde"], curve[:, -1], equal_nan=True)


def test_best_displacement_is_that_of_the_best_of_the_heaviest_components():
    forecast, future = sample()
    found = best_average_displacement(forecast, future, 2)
    assert math.isnan(found[1])
    for row in (0, 2, 3):
        heaviest = forecast.log_weight[row].argsort(descending=True)[:2]
        expected = min(mean(distances(forecast.mean[:, k], future, row)) for k in heaviest)
        assert float(found[row]) == pytest.approx(expected, rel=1e-5)


def test_the_best_displacement_of_several_agents_of_each_sample_is_that_of_each():
    forecast, future = sample()
    apart = (
        map_tensors(lambda field: field.unflatten(0, (3, 2)), each) for each in (forecast, future)
    )
    found, expected = (
        best_average_displacement(*apart, 2),
        best_average_displacement(forecast, future, 2),
    )
    assert found.shape == (3, 2)
    assert torch.equal(found.flatten().nan_to_num(-1), expected.nan_to_num(-1))


def test_best_of_one_component_is_the_most_likely_one():
    forecast, future = sample()
    alone = average_displacement(forecast.most_likely(), future)
    assert torch.allclose(best_average_displacement(forecast, future, 1), alone, equal_nan=True)


@pytest.mark.parametrize(("rank", "counts"), [(0, True), (4, True), (5, False), (6, False)])
def test_the_best_displacement_is_among_the_five_heaviest_components(rank, counts) -> None:
    forecast, future = sample(components=7)
    weight = torch.tensor([0.25, 0.2, 0.15, 0.12, 0.11, 0.1, 0.07]).log().expand(6, 7)
    mean = torch.full_like(forecast.mean, 50.0)
    mean[:, rank] = future.motion.position.nan_to_num(0.0)
    found = best_average_displacement(forecast._replace(log_weight=weight, mean=mean), future)
    assert (found[[0, 2, 3]] == 0.0).tolist() == [counts] * 3


@pytest.mark.parametrize("offset_m", [0.0, 1.0])
@pytest.mark.parametrize(
    "score",
    [average_displacement, final_displacement, mean_square_displacement],
    ids=lambda score: score.__name__,
)
def test_gradients_are_finite_beside_the_unknown_and_on_the_truth_itself(score, offset_m):
    future = sample()[1]
    path = (future.motion.position.nan_to_num(7.0) + offset_m).requires_grad_()
    found = score(path, future)
    masked_mean(found, ~torch.isnan(found)).backward()
    assert torch.isfinite(path.grad).all()
    assert (path.grad[~future.valid] == 0).all()
    assert bool(path.grad[0].abs().max() > 0) is (offset_m > 0)


def test_a_miss_is_further_than_its_limit():
    future = tracks(torch.zeros(3, 2, 2), torch.ones(3, 2, dtype=torch.bool))
    path = torch.zeros(3, 2, 2)
    path[:, -1, 0] = torch.tensor([0.9, 1.0, 1.1])
    assert missed(path, future, limit_m=1.0).tolist() == [0.0, 0.0, 1.0]
