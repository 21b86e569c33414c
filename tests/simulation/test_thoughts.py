"""What a controller expected and planned, by episode and decision."""

import numpy as np
import torch

from diffstack_mmv.simulation.thoughts import Thought, joined


def told(rows, value):
    count = len(rows)
    return Thought(
        torch.tensor(rows),
        torch.full((count, 3, 2), value),
        torch.full((count, 1, 2, 5), value),
        torch.full((count, 1 + int(value), 3, 2), value),
    )


def test_each_decision_goes_to_its_episodes_and_ended_ones_are_unknown():
    arrays = joined([told([0, 1], 1.0), told([1], 2.0)], 2)
    assert arrays["plan"].shape == (2, 2, 3, 2)
    assert arrays["forecast"].shape == (2, 2, 1, 2, 5)
    assert (arrays["plan"][1, :, 0, 0] == [1.0, 2.0]).all()
    assert np.isnan(arrays["plan"][0, 1]).all()
    assert arrays["candidates"].shape == (2, 2, 3, 3, 2)
    assert np.isnan(arrays["candidates"][1, 0, 2]).all()
    assert arrays["forecast"].dtype == np.float16
