"""The one form in which a bad argument is told."""

import re

import numpy as np
import pytest
import torch

from diffstack_mmv import checks
from diffstack_mmv.vehicles.values import require_keys
from dmmv_conventions.checks import require_one_of


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_positive_refuses_zero_negative_and_not_finite(value):
    with pytest.raises(ValueError, match="`dt_s` must be positive"):
        checks.require_positive("dt_s", value)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    "check",
    [
        lambda value: checks.require_positive("dt_s", value),
        lambda value: checks.require_at_least("dt_s", value, 0),
        lambda value: checks.require_between("dt_s", value, 0, 1),
        lambda value: checks.require_multiple("dt_s", value, 0.1),
    ],
)
def test_a_number_in_quotes_is_told_with_its_quotes(check):
    with pytest.raises(ValueError, match=r"`dt_s` must be a number, but got '0\.25'"):
        check("0.25")


@pytest.mark.parametrize("value", [2.5, 2.0, "2", None, True, float("nan")])
def test_only_whole_numbers_are_whole(value):
    checks.require_whole("humans", 2)
    checks.require_whole("humans", np.int64(2))
    with pytest.raises(ValueError, match="`humans` must be a whole number, but got"):
        checks.require_whole("humans", value)


@pytest.mark.parametrize("value", ["yes", "no", "", None, 2, [True]])
def test_what_only_counts_as_true_or_false_is_no_switch(value):
    for switch in (True, False, 1, 0, np.bool_(True)):
        checks.require_switch("compile", switch)
    told = re.escape(f"`compile` must be true or false, but got {value!r}.")
    with pytest.raises(ValueError, match=told):
        checks.require_switch("compile", value)


@pytest.mark.parametrize(("value", "steps"), [(3.0, 30), (0.1, 1), (4.0, 40), (0.3, 3)])
def test_multiples_survive_binary_rounding(value, steps):
    assert checks.require_multiple("horizon_s", value, 0.1) == steps


@pytest.mark.parametrize("value", [0.05, 2.95, 0.101])
def test_a_horizon_that_is_no_multiple_of_the_step_is_refused(value):
    with pytest.raises(ValueError, match=r"`horizon_s` must be a multiple of 0.1, but got .* Take"):
        checks.require_multiple("horizon_s", value, 0.1)


@pytest.mark.parametrize(
    ("check", "arguments", "told"),
    [
        (
            checks.require_columns,
            ("state", torch.zeros(2, 2), 3, ("a", "b", "c")),
            r"3 columns \(a, b, c\).*shape \(2, 2\)",
        ),
        (
            checks.require_finite,
            ("state", torch.tensor([float("nan"), 1.0, float("inf")])),
            "2 of 3 entries",
        ),
        (
            checks.require_one_of,
            ("mode", "bike", ["scooter", "bicycle"]),
            "be one of bicycle, scooter, but got 'bike'",
        ),
    ],
    ids=["columns are named", "not finite entries are counted", "known names are listed"],
)
def test_a_refusal_tells_what_is_wrong(check, arguments, told):
    with pytest.raises(ValueError, match=told):
        check(*arguments)


@pytest.mark.parametrize(
    ("check", "arguments"),
    [
        (checks.require_at_least, ("n", 0, 1)),
        (checks.require_at_least, ("n", float("nan"), 1)),
        (checks.require_between, ("n", 2, 0, 1)),
    ],
)
def test_values_outside_a_range_are_refused(check, arguments):
    with pytest.raises(ValueError, match="`n` must"):
        check(*arguments)


def ask_for_nothing(*_):
    raise AssertionError("a question for what needs none")


@pytest.mark.parametrize(
    "judge",
    [
        lambda: require_one_of("phase", "test", ("train", "val", "test")),
        lambda: require_keys({"mass_kg": 80.0}, ["mass_kg"], ["name"], "", ""),
    ],
    ids=["a name", "keys of a vehicle"],
)
def test_what_else_was_meant_is_looked_for_only_where_something_is_wrong(monkeypatch, judge):
    """It takes a hundred times as long as the check, which stands in every drive."""
    for place in ("dmmv_conventions.checks", "diffstack_mmv.vehicles.values"):
        monkeypatch.setattr(f"{place}.did_you_mean", ask_for_nothing)
    judge()
