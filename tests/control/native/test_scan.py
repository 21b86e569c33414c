"""Rows stepped forward in a library are those of the loop in tensors."""

import pytest
import torch

from diffstack_mmv.control.native.scan import _fit, scan
from diffstack_mmv.dynamics import DiffKBM, rollout
from diffstack_mmv.vehicles import load_vehicle


def stepping(model):
    """A step whose output is the speed before it."""

    def step(state, control):
        return model.step(state, control), state[..., 3:]

    return step


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("rows", [1, 11])
@pytest.mark.parametrize("steps", [1, 6])
def test_every_row_is_rolled_out(dtype, rows, steps):
    model = DiffKBM(load_vehicle("bicycle"), 0.1).to(dtype)
    draw = torch.Generator().manual_seed(rows)
    state = torch.rand(rows, 4, generator=draw, dtype=dtype)
    controls = torch.randn(rows, steps, 2, generator=draw, dtype=dtype)
    found = scan(stepping(model), state, controls)
    expected = rollout(model, state, controls)
    torch.testing.assert_close(found.states, expected)
    torch.testing.assert_close(found.outputs[..., 0], expected[:, :-1, 3])


def test_the_tensors_that_a_step_hides_may_change():
    scale = torch.tensor([2.0])
    state, inputs = torch.ones(3, 1), torch.ones(3, 2, 1)

    def step(state, row):
        return state * scale + row, state

    assert torch.equal(scan(step, state, inputs).states[0, :, 0], torch.tensor([1.0, 3.0, 7.0]))
    scale += 1
    assert torch.equal(scan(step, state, inputs).states[0, :, 0], torch.tensor([1.0, 4.0, 13.0]))


def sorts(state, row):
    return state.sort(-1).values, row


def plain(state, row):
    return state, row


@pytest.mark.parametrize(
    ("step", "rows", "dtype"),
    [(sorts, 3, torch.float32), (plain, 0, torch.float32), (plain, 3, torch.half)],
)
def test_what_has_no_scalar_form_no_rows_or_no_precision_has_no_library(step, rows, dtype):
    state, inputs = torch.ones(rows, 2, dtype=dtype), torch.ones(rows, 2, 1, dtype=dtype)
    assert scan(step, state, inputs) is None


@pytest.mark.parametrize(
    ("state", "inputs"), [((1, 2), (9, 2, 1)), ((9, 2), (3, 2, 1)), ((2,), (2, 1))]
)
def test_rows_that_do_not_fit_together_are_left_to_tensors(state, inputs):
    assert _fit(torch.ones(3, 2), torch.ones(3, 2, 1))
    assert not _fit(torch.ones(state), torch.ones(inputs))
