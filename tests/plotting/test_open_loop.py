"""Runs of several models under the same commands, drawn."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from diffstack_mmv.plotting import draw_runs, draw_wheels
from diffstack_mmv.types import Motion


@pytest.mark.parametrize(
    ("lean", "told"), [(None, ["the model has no lean"]), (np.array([0.0, 0.1, 0.2]), [])]
)
def test_a_model_without_lean_is_not_told_to_be_a_vehicle_that_does_not(lean, told):
    motion = Motion(torch.zeros(3, 2), torch.zeros(3), torch.ones(3, 2), torch.zeros(3))
    *_, roll = draw_runs({"kbm": motion}, 0.1, lean).axes
    assert [text.get_text() for text in roll.texts] == told
    assert len(roll.get_lines()) == (0 if lean is None else 1)


def test_as_many_models_as_there_are_have_lines_that_are_seen_and_told_apart():
    motion = Motion(torch.zeros(3, 2), torch.zeros(3), torch.ones(3, 2), torch.zeros(3))
    figure = draw_runs({f"model {index}": motion for index in range(9)}, 0.1, None)
    looks = [(line.get_color(), line.get_linewidth()) for line in figure.axes[0].get_lines()]
    assert len(set(looks)) == 9
    assert min(width for _, width in looks) > 0.5


@pytest.mark.parametrize("wheels", [2, 5])
def test_the_legend_of_the_loads_hides_none_of_them(wheels):
    load = torch.arange(1.0, wheels + 1).repeat(3, 1)
    history = SimpleNamespace(normal_load=load, friction_limit=load, force_x=load, force_y=load)
    figure = draw_wheels(history, [f"rear wheel {number}" for number in range(wheels)], 0.1)
    figure.draw_without_rendering()
    axes = figure.axes[1]
    legend = axes.get_legend().get_window_extent()
    assert legend.y0 > axes.transData.transform((0.0, float(wheels)))[1]
    assert legend.x0 >= axes.get_window_extent().x0
