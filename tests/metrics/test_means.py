"""Means leave out what cannot be judged, in value and in gradient."""

import math

import pytest
import torch

from diffstack_mmv.metrics import masked_mean, time_mean, where_known


def test_time_mean_equals_a_loop():
    values, valid = torch.randn(20, 6), torch.rand(20, 6) < 0.4
    for row, mean in enumerate(time_mean(values, valid).tolist()):
        kept = [float(v) for v, seen in zip(values[row], valid[row], strict=True) if seen]
        expected = sum(kept) / len(kept) if kept else math.nan
        assert mean == pytest.approx(expected, rel=1e-5, nan_ok=True)


@pytest.mark.parametrize("shape", [(), (3,), (3, 2), (2, 0)])
def test_time_mean_is_over_the_last_dimension_alone(shape) -> None:
    values, valid = torch.randn(6, 5), torch.rand(6, 5) < 0.5
    count = math.prod(shape)
    case = [each[:count].reshape(*shape, 5) for each in (values, valid)]
    expected = time_mean(values, valid)[:count].reshape(shape)
    torch.testing.assert_close(time_mean(*case), expected, equal_nan=True)


@pytest.mark.parametrize("spoiler", [torch.nan, torch.inf, 1e9])
def test_what_stands_at_times_not_valid_does_not_count(spoiler):
    values, valid = torch.randn(3, 4), torch.ones(3, 4, dtype=torch.bool)
    valid[:, 2] = False
    spoiled = values.clone()
    spoiled[:, 2] = spoiler
    assert torch.equal(time_mean(spoiled, valid), time_mean(values, valid))


@pytest.mark.parametrize(
    ("values", "counted", "expected"),
    [
        ([1.0, 3.0], [True, True], 2.0),
        ([1.0, math.nan, 3.0], [True, False, True], 2.0),
        ([1.0, 3.0], [False, True], 3.0),
        ([1.0, 3.0], [False, False], 0.0),
        ([math.nan], [False], 0.0),
        ([], [], 0.0),
        ([1.0, math.nan], [True, True], math.nan),
    ],
)
def test_masked_mean_is_over_the_samples_that_count(values, counted, expected):
    found = masked_mean(torch.tensor(values), torch.tensor(counted, dtype=torch.bool))
    assert float(found) == pytest.approx(expected, nan_ok=True)


def test_gradient_of_a_masked_mean_reaches_the_samples_that_count_alone():
    values = torch.tensor([1.0, 2.0, 3.0, 4.0], requires_grad=True)
    known = torch.tensor([True, True, False, True])
    counted = known & torch.tensor([True, False, True, True])
    masked_mean(where_known(values, known), counted).backward()
    assert values.grad.tolist() == [0.5, 0.0, 0.0, 0.5]


@pytest.mark.parametrize("known", [[True, False], [False, False]])
def test_gradient_of_a_mean_over_times_is_that_of_its_differences(known, double):
    counted = torch.tensor(known)
    valid = counted.unsqueeze(-1).expand(2, 3)
    values = torch.randn(2, 3, requires_grad=True)
    assert torch.autograd.gradcheck(lambda v: masked_mean(time_mean(v, valid), counted), values)
