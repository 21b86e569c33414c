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


SIZES = (1.0, 0.5, 0.25)
BOX = torch.tensor([[-0.4, -1.0], [0.4, 1.0]], dtype=torch.float64)


def pendulum(state, control):
    angle, rate = state.unbind(-1)
    push, drag = control.unbind(-1)
    return torch.stack([angle + 0.3 * rate, rate - angle.sin() + push - drag * rate], -1)


def price(states, controls):
    return states.square().sum(-1) + 0.1 * controls.square().sum(-1)


def rolled(x, u, gains, size):
    """One problem at one step size: its states, its controls and their cost."""
    state, states, controls = x[0], [x[0]], []
    for old_x, old_u, row in zip(x[:-1], u, gains, strict=True):
        control = old_u + size * row[:2] + row[2:].reshape(2, 2) @ (state - old_x)
        control = control.clamp(BOX[0], BOX[1])
        state = pendulum(state, control)
        states.append(state)
        controls.append(control)
    states, controls = torch.stack(states), torch.stack(controls)
    padded = torch.cat([controls, torch.zeros(1, 2, dtype=torch.float64)])
    return states, controls, price(states, padded).sum()


def problems(count=5, steps=4):
    generator = torch.Generator().manual_seed(0)
    shapes = (steps + 1, 2, count), (steps, 2, count), (steps, 6, count)
    return [torch.randn(shape, generator=generator, dtype=torch.float64) for shape in shapes]


def searched(x, u, gains, cost=price):
    """The best of all step sizes, by the search."""
    like, noise = torch.zeros(x.shape[-1]).double(), torch.zeros(x.shape[-1]).double()
    sizes = torch.tensor(SIZES).double()
    return search(pendulum, cost, like, x, u, gains, BOX, sizes, noise)


def test_each_problem_gets_the_cheapest_of_its_roll_outs_in_the_box():
    x, u, gains = problems()
    found, taken = searched(x, u, gains), set()
    for number in range(x.shape[-1]):
        own = [part[..., number] for part in (x, u, gains)]
        each = [(*rolled(*own, size), size) for size in SIZES]
        states, controls, cost, size = min(each, key=lambda entry: float(entry[2]))
        torch.testing.assert_close(found.x[..., number], states)
        torch.testing.assert_close(found.u[..., number], controls)
        torch.testing.assert_close(found.cost[number], cost)
        assert found.size[number] == size
        taken.add(size)
    assert len(taken) > 1


@pytest.mark.parametrize(("lost", "size"), [(0.9, 0.5), (0.4, 0.25)])
def test_a_step_whose_cost_is_no_number_is_not_taken(lost, size):
    """Whose first control is `lost` or more; the others only cost more, the shorter they are."""
    x, u, gains = (torch.zeros_like(part) for part in problems())
    gains[0, 1] = 1.0

    def broken(states, controls):
        first = controls[..., :1, 1]
        whole = torch.where(first >= lost, torch.nan, -first)
        return whole + 0 * states[..., 0]

    found = searched(x, u, gains, broken)
    assert found.size.tolist() == [size] * x.shape[-1]
    assert found.cost.isfinite().all()
