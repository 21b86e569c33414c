"""The one form in which a bad argument is told."""

import pytest

from dmmv_conventions.checks import did_you_mean, message, require, require_multiple, require_one_of


@pytest.mark.parametrize(
    ("where", "remedy", "told"),
    [
        (
            "for 'x'",
            "Give kilograms.",
            "`mass_kg` must be positive, but got -1 for 'x'. Give kilograms.",
        ),
        ("", "Give kilograms.", "`mass_kg` must be positive, but got -1. Give kilograms."),
        ("for 'x'", "", "`mass_kg` must be positive, but got -1 for 'x'."),
        ("", "", "`mass_kg` must be positive, but got -1."),
    ],
)
def test_a_message_names_argument_requirement_value_place_and_remedy(where, remedy, told):
    assert message("mass_kg", "be positive", -1, where, remedy) == told


class OtherError(ValueError):
    """An error of somebody else."""


@pytest.mark.parametrize("error", [ValueError, OtherError])
def test_a_value_is_refused_with_the_error_of_the_caller(error):
    require(True, "mass_kg", "be positive", 1, error=error)
    with pytest.raises(error, match="`mass_kg` must be positive, but got -1") as caught:
        require(False, "mass_kg", "be positive", -1, error=error)
    assert type(caught.value) is error


@pytest.mark.parametrize("step", [0.0, -0.1, float("nan")])
def test_a_step_that_is_not_positive_is_told(step):
    with pytest.raises(ValueError, match="`horizon_s` must be a multiple of a positive step"):
        require_multiple("horizon_s", 3.0, step)


@pytest.mark.parametrize(
    ("name", "told"),
    [("vla", "but got 'vla'. Did you mean 'val'[?]$"), ("horse", "but got 'horse'[.]$")],
)
def test_a_wrong_name_is_told_the_one_that_may_be_meant(name, told):
    require_one_of("split", "val", ["train", "val"])
    with pytest.raises(ValueError, match=f"`split` must be one of train, val, {told}"):
        require_one_of("split", name, ["train", "val"])


@pytest.mark.parametrize("name", ["DIFFKBM", "diffkbm", "DiffKMB"])
def test_case_does_not_count_where_a_name_is_looked_for(name):
    assert did_you_mean(name, ["DiffGM3", "DiffKBM"]) == "Did you mean 'DiffKBM'?"
