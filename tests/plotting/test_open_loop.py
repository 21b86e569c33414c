"""Runs of several models under the same commands, drawn."""

import numpy as np
import pytest
import torch

from diffstack_mmv.plotting import draw_runs
from diffstack_mmv.types import Motion


@pytest.mark.parametrize(
    ("lean", "told"), [(None, ["the model has no lean"]), (np.array([0.0, 0.1, 0.2]), [])]
)
def test_a_model_without_lean_is_not_told_to_be_a_vehicle_that_does_not(lean, told):
    motion = Motion(torch.zeros(3, 2), torch.zeros(3), torch.ones(3, 2), torch.zeros(3))
    *_, roll = draw_runs({"kbm": motion}, 0.1, lean).axes
    assert [text.get_text() for text in roll.texts] == told
    assert len(roll.get_lines()) == (0 if lean is None else 1)
