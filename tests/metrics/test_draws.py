"""Draws for scores: the same for a forecast whatever is judged beside it."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from diffstack_mmv.metrics.draws import components_of, drawn_rows

SHARES = st.floats(0, 1, exclude_max=True)


def normal(generator):
    return torch.randn(3, generator=generator)


@given(SHARES, st.lists(st.floats(0.01, 1), min_size=1, max_size=6))
def test_a_component_is_drawn_where_the_share_lies_in_the_sum_of_the_weights(share, weights):
    weight = torch.tensor(weights, dtype=torch.float64)
    edges = torch.cat([torch.zeros(1), weight.cumsum(0) / weight.sum()])
    drawn = components_of(weight.log(), torch.tensor([share], dtype=torch.float64)).item()
    assert edges[drawn] - 1e-6 <= share <= edges[drawn + 1] + 1e-6


@given(SHARES)
def test_a_component_without_weight_is_never_drawn(share):
    log_weight = torch.tensor([0.0, 0.3, 0.0, 0.7, 0.0]).log()
    assert components_of(log_weight, torch.tensor([share], dtype=torch.float64)).item() in (1, 3)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_weights_need_not_sum_to_one(scale):
    share = torch.linspace(0, 0.99, 34)
    weight = torch.tensor([0.2, 0.5, 0.3])
    same = components_of(weight.log(), share)
    assert torch.equal(components_of((scale * weight).log(), share), same)


@pytest.mark.parametrize("shape", [(), (4,), (2, 3), (0,), (2, 0)])
def test_draws_have_the_dimensions_of_the_forecasts_before_their_own(shape):
    assert drawn_rows(shape, normal, seed=0, first=0).shape == (*shape, 3)


@pytest.mark.parametrize("cut", [1, 2, 4])
def test_draws_of_a_forecast_do_not_depend_on_its_batch(cut):
    whole = drawn_rows((5,), normal, seed=7, first=10)
    head = drawn_rows((cut,), normal, seed=7, first=10)
    tail = drawn_rows((5 - cut,), normal, seed=7, first=10 + cut)
    assert torch.equal(torch.cat([head, tail]), whole)


def test_forecasts_and_seeds_have_draws_of_their_own():
    one, other = drawn_rows((2,), normal, seed=0, first=0)
    assert not torch.equal(one, other)
    assert not torch.equal(drawn_rows((2,), normal, seed=1, first=0)[0], one)


def test_draws_leave_the_random_numbers_of_the_program_alone():
    """A validation would change the training after it."""
    before = torch.get_rng_state()
    drawn_rows((2,), normal, seed=0, first=0)
    assert torch.equal(torch.get_rng_state(), before)
