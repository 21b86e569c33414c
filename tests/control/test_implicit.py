"""The gradient of a solution is that of the converged solution, not of the iterations."""

import pytest
import torch
from tests.control.problems import driving, solve

from diffstack_mmv.control import ILQR

EXACT = ILQR(tolerance=1e-16)


def functional(solution):
    """A number that depends on every part of the solutions."""
    return (
        solution.states.sin().sum() + solution.controls.square().sum() + 0.3 * solution.cost.sum()
    )


def finite_difference(hidden, name, box, controls, step=1e-5):
    """Central differences of the re-converged solutions along a fixed direction."""
    direction = torch.linspace(-1, 1, hidden[name].numel()).reshape(hidden[name].shape) + 0.3
    values = []
    for sign in (1, -1):
        moved = hidden | {name: hidden[name] + sign * step * direction}
        values.append(functional(solve(EXACT, moved, box, controls)))
    return (values[0] - values[1]) / (2 * step), direction


@pytest.mark.usefixtures("double")
@pytest.mark.parametrize("limit", [50.0, 1.0], ids=["free", "at the bounds"])
@pytest.mark.parametrize("name", ["state", "goal", "weight", "wheelbase"])
def test_gradient_equals_finite_differences(limit, name):
    hidden, box, controls = driving(limit=limit)
    warm = solve(EXACT, hidden, box, controls).controls
    assert ((warm == box.lower) | (warm == box.upper)).any() == (limit < 2)
    hidden[name].requires_grad_()
    functional(solve(EXACT, hidden, box, warm)).backward()
    expected, direction = finite_difference(
        {k: v.detach() for k, v in hidden.items()}, name, box, warm
    )
    torch.testing.assert_close(
        (hidden[name].grad * direction).sum(), expected, rtol=1e-6, atol=1e-8
    )
