"""The one form in which a bad argument is told."""

import pytest

from dmmv_conventions.checks import message, require


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
