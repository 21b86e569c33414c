"""The test of differences between two evaluations."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from diffstack_mmv.reporting.paired_tests import holm, signed_rank

DIFFERENCES = st.lists(st.floats(0.01, 5), min_size=6, max_size=20, unique=True)


@given(DIFFERENCES, st.randoms())
def test_it_does_not_matter_which_of_two_runs_is_called_first(sizes, random):
    difference = np.array([size * random.choice([-1, 1]) for size in sizes])
    value = signed_rank(difference)
    assert 0 <= value <= 1
    assert math.isclose(signed_rank(-difference), value)


@pytest.mark.parametrize("count", [6, 8, 10])
def test_pairs_that_all_differ_the_same_way_have_the_least_p_value(count):
    assert math.isclose(signed_rank(np.arange(1.0, count + 1)), 2 * 0.5**count)


@pytest.mark.parametrize("difference", [[], [0.0] * 9, [1.0] * 5, [1.0] * 5 + [0.0] * 9])
def test_too_few_unequal_pairs_decide_nothing(difference):
    assert math.isnan(signed_rank(np.array(difference)))


@pytest.mark.parametrize("scale", [4e-8, -4e-8])
def test_what_rounding_makes_differ_decides_nothing(scale):
    assert math.isnan(signed_rank(scale * np.arange(1.0, 12)))


@given(st.lists(st.integers(-9, 9), min_size=8, max_size=20))
def test_differences_that_rounding_sets_apart_are_ties(tenths):
    exact = np.array(tenths) / 10
    shifted = (exact + 0.7) - 0.7
    assert np.array_equal(signed_rank(shifted), signed_rank(exact), equal_nan=True)


@pytest.mark.parametrize(
    ("told", "corrected"),
    [
        ([0.01, 0.04, 0.03, 0.005], [0.03, 0.06, 0.06, 0.02]),
        ([0.03, np.nan, 0.02], [0.04, np.nan, 0.04]),  # what was not tested does not count
        ([0.6, 0.7, 0.9], [1.0, 1.0, 1.0]),
        ([0.02], [0.02]),
        ([], []),
    ],
)
def test_p_values_are_corrected_for_their_number(told, corrected):
    assert np.allclose(holm(np.array(told)), corrected, equal_nan=True)


def test_of_many_tests_of_nothing_one_in_twenty_families_finds_something():
    families = np.random.default_rng(0).uniform(size=(2000, 10))
    found = np.mean([holm(family).min() < 0.05 for family in families])
    assert abs(found - 0.05) < 3 * np.sqrt(0.05 * 0.95 / 2000)
