"""Errors over the horizon."""

import numpy as np

from diffstack_mmv.metrics import DISPLACEMENT
from diffstack_mmv.plotting import draw_error_over_horizon


def test_every_mode_is_a_panel_with_the_title_of_the_score_and_gaps_are_drawn():
    errors = {"bicycle": {"plan": np.array([0.1, np.nan])}, "scooter": {"plan": np.ones(2)}}
    figure = draw_error_over_horizon(errors, 0.1, DISPLACEMENT.heading)
    assert [axes.get_title() for axes in figure.axes] == ["bicycle", "scooter"]
    assert {axes.get_ylabel() for axes in figure.axes} == {"mean distance to the human [m]"}
