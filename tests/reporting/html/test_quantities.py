"""Entries of states and controls under titles with their units."""

import pytest

from diffstack_mmv.dynamics import DiffGM3, DiffKBM, ExtendedUnicycle, SingleIntegrator
from diffstack_mmv.reporting.html.quantities import quantity


@pytest.mark.parametrize(
    ("name", "title"),
    [
        ("time_s", "time [s]"),
        ("position_x", "position x [m]"),
        ("velocity_left", "velocity left [m/s]"),
        ("acceleration_y", "acceleration y [m/s²]"),
        ("lean_rate", "lean rate [rad/s]"),
        ("control 0", "control 0"),
    ],
)
def test_a_title_has_the_unit_where_it_is_known(name, title):
    assert quantity(name) == title


@pytest.mark.parametrize("model", [DiffGM3, DiffKBM, ExtendedUnicycle, SingleIntegrator])
def test_every_entry_of_a_model_has_a_unit(model):
    names = (*model.State._fields, *model.Control._fields)
    assert [name for name in names if "[" not in quantity(name)] == []
