"""Gradients at the edges: of prices that are zero, by bounds at the start, without a solution."""

import pytest
import torch
from torch import Tensor

from diffstack_mmv.control import ILQR, Bounds
from diffstack_mmv.control.constrained import (
    ConstrainedILQR,
    ConstrainedSolution,
    Inequality,
    Slack,
)
from tests.control.constrained.test_gradient import cart, functional, reach

pytestmark = pytest.mark.usefixtures("double")
EXACT = ConstrainedILQR(ILQR(tolerance=1e-16))


def stopped(
    slack: Slack,
    upper: Tensor,
    coupling: float = 0.0,
    solver: ConstrainedILQR = EXACT,
    batch: tuple[int, ...] = (),
) -> ConstrainedSolution:
    """A cart that a wall at 2 keeps from its goal; its cost may couple place and force."""

    def cost(states: Tensor, forces: Tensor) -> Tensor:
        return reach(states, forces) + coupling * states[..., 0] * forces[..., 0]

    def wall(states: Tensor, forces: Tensor) -> Tensor:
        return states[..., :1] - 2

    limits, box = [Inequality(wall, slack, slice(5, None))], Bounds(-upper, upper)
    start = torch.tensor([0.3, 0.0]).expand(*batch, 2)
    return solver(cart, cost, limits, box, start, torch.zeros(*batch, 10, 1))


@pytest.mark.parametrize(
    "prices", [(0.0, 3.0), (0.4, 0.0)], ids=["no linear price", "no price of squares"]
)
def test_a_price_of_zero_has_the_derivative_of_one_that_is_raised(
    prices: tuple[float, float],
) -> None:
    raised = torch.tensor([[0.0, 0.0], [1e-6, 0.0], [0.0, 1e-6]])
    given = (torch.tensor(prices) + raised).requires_grad_()
    linear, quadratic = given[:, :, None, None].unbind(1)
    value = functional(stopped(Slack(linear, quadratic), torch.tensor([6.0]), batch=(3,)))
    gradient = torch.autograd.grad(value[0], given)[0][0]
    expected = (value[1:] - value[0]).detach() / 1e-6
    torch.testing.assert_close(gradient, expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("coupling", [-0.2, 0.2])
def test_a_bound_that_holds_the_first_force_has_its_derivative(coupling: float) -> None:
    upper = torch.tensor([4.0], requires_grad=True)
    found = stopped(Slack(torch.inf), upper, coupling)
    assert found.controls[0] == upper
    gradient = torch.autograd.grad(functional(found), upper)[0]
    sides = [stopped(Slack(torch.inf), upper.detach() + e, coupling) for e in (1e-5, -1e-5)]
    expected = (functional(sides[0]) - functional(sides[1])) / 2e-5
    torch.testing.assert_close(gradient[0], expected.detach(), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("part", ["cost", "multipliers"])
def test_what_did_not_converge_has_no_gradient_by_its_price(part: str) -> None:
    price = torch.tensor(0.4, requires_grad=True)
    solver = ConstrainedILQR(max_iterations=1)
    found = stopped(Slack(price), torch.tensor([6.0]), solver=solver)
    assert not found.converged
    told = found.cost if part == "cost" else found.multipliers[0].sum()
    (slope,) = torch.autograd.grad(told, price)
    assert slope == 0


@pytest.mark.parametrize("place", [torch.inf, 30.0], ids=["nowhere", "far away"])
def test_a_wall_out_of_reach_changes_neither_cost_nor_gradient(place: float) -> None:
    goal = torch.tensor(1.0, requires_grad=True)

    def reached(*limits: Inequality) -> Tensor:
        def cost(states: Tensor, forces: Tensor) -> Tensor:
            return (states[..., 0] - goal).square() + 0.01 * forces.square().sum(-1)

        box = Bounds(torch.tensor([-9.0]), torch.tensor([9.0]))
        found = EXACT(cart, cost, limits, box, torch.zeros(2), torch.zeros(10, 1))
        slope = torch.autograd.grad(found.cost + functional(found), goal)[0]
        return torch.stack([found.cost.detach(), slope])

    wall = Inequality(lambda states, forces: states[..., :1] - place)
    torch.testing.assert_close(reached(wall), reached())


@pytest.mark.parametrize("times", [slice(5, None), slice(None)], ids=["not there", "infinite"])
def test_a_limit_at_infinity_for_some_of_the_time_is_none(times: slice) -> None:
    places = torch.full((11, 1), 2.0)
    places[:5] = torch.inf
    box = Bounds(torch.tensor([-6.0]), torch.tensor([6.0]))
    limit = Inequality(lambda states, forces: states[..., :1] - places, times=times)
    found = EXACT(cart, reach, [limit], box, torch.tensor([0.3, 0.0]), torch.zeros(10, 1))
    torch.testing.assert_close(found.cost, stopped(Slack(torch.inf), box.upper).cost)


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("nearer", "acts"), [(1e-9, False), (1e-3, True)])
def test_a_wall_acts_where_it_costs_anything(
    nearer: float, acts: bool, side: float, unit: float
) -> None:
    """By how much it stands before the end of the way without it, whatever the unit of the cost."""

    def ended(wall: Tensor) -> Tensor:
        def cost(states: Tensor, forces: Tensor) -> Tensor:
            return unit * reach(side * states, forces)

        limit = Inequality(lambda states, forces: side * states[..., :1] - wall)
        box = Bounds(torch.tensor([-9.0]), torch.tensor([9.0]))
        found = EXACT(cart, cost, [limit], box, torch.zeros(2), torch.zeros(10, 1))
        assert found.converged
        return side * found.states[-1, 0]

    wall = (ended(torch.tensor(9.0)) - nearer).requires_grad_()
    (slope,) = torch.autograd.grad(ended(wall), wall)
    assert float(slope) == pytest.approx(float(acts), abs=1e-6)


def test_a_price_of_next_to_nothing_has_the_derivative_of_what_it_presses_with() -> None:
    price = torch.tensor(1e-9, requires_grad=True)
    found = stopped(Slack(quadratic=price), torch.tensor([6.0]))
    beyond = (found.states[5:, 0] - 2).clamp_min(0).sum()
    assert beyond > 0.1
    (slope,) = torch.autograd.grad(found.multipliers[0].sum(), price)
    torch.testing.assert_close(slope, beyond.detach())
