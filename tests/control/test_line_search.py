"""Which of several step sizes is taken."""

import pytest
import torch

from diffstack_mmv.control.line_search import search


@pytest.mark.parametrize(("noise", "taken"), [(0.0, 0.5), (0.7, 0.5), (0.8, 1.0)])
def test_the_longest_of_the_steps_that_rounding_cannot_tell_apart_is_taken(noise, taken):
    """One step of x + u at the cost u², where a gain of one makes the control the step size."""
    zero = torch.zeros(1, 1, 1)
    found = search(
        lambda state, control: state + control,
        lambda states, controls: controls.square().sum(-1),
        torch.zeros(1),
        torch.zeros(2, 1, 1),
        zero,
        torch.tensor([[[1.0], [0.0]]]),
        torch.tensor([[-9.0], [9.0]]),
        torch.tensor([1.0, 0.5]),
        torch.tensor([noise]),
    )
    assert found.size.tolist() == [taken]
