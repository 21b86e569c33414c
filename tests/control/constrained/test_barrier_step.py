"""The Newton step of the barrier problem solves the linearised optimality conditions."""

from typing import NamedTuple

import pytest
import torch
from torch import Tensor

from diffstack_mmv.control import Bounds
from diffstack_mmv.control.constrained import Equality, Inequality, Slack
from diffstack_mmv.control.constrained.barrier import Barrier, Interior
from diffstack_mmv.control.constrained.barrier_rows import barrier_rows
from diffstack_mmv.control.constrained.barrier_step import Newton, newton
from diffstack_mmv.control.constrained.constraint import gather
from diffstack_mmv.control.constrained.filter import longest
from diffstack_mmv.control.constrained.local import Problem, expand_problem

pytestmark = pytest.mark.usefixtures("double")
SCALE, MU = torch.tensor([1.0, 3.0]).double(), torch.tensor([0.2, 0.05]).double()
T = 4
BOXES = {
    "bounded": ([-4.0, -3.0], [5.0, 2.0]),
    "one side open": ([-4.0, -torch.inf], [torch.inf, 2.0]),
    "open": ([-torch.inf] * 2, [torch.inf] * 2),
    "one fixed": ([-4.0, 0.7], [5.0, 0.7]),
}
ALL = torch.tensor([True, True])


def sledge(state: Tensor, force: Tensor) -> Tensor:
    """Linear, so that a step closes all defects."""
    place, speed = state.unbind(-1)
    push, slide = force.unbind(-1)
    return torch.stack([place + 0.3 * speed + 0.1 * slide, 0.9 * speed + 0.2 * push], -1)


def quadratic(states: Tensor, forces: Tensor) -> Tensor:
    place, speed = states.unbind(-1)
    mixed = 0.3 * place * forces[..., 0] + 0.2 * speed * forces[..., 1]
    return (place - 3).square() + 0.5 * speed.square() + forces.square().sum(-1) + mixed


def bent(states: Tensor, forces: Tensor) -> Tensor:
    """Falls without end along the controls, but for its bounds."""
    return quadratic(states, forces) - 9 * forces.square().sum(-1)


LIMITS = [
    Inequality(lambda x, u: x[..., :1] + 0.5 * u[..., :1] - 2),
    Inequality(lambda x, u: x[..., 1:] - 1, Slack(4.0), slice(1, None)),
    Inequality(lambda x, u: -x[..., :1] - u[..., 1:], Slack(0.5, 2.0)),
    Equality(lambda x, u: x[..., 1:] - u[..., :1], Slack(3.0, 1.0), slice(1, 3)),
    Equality(lambda x, u: 1 - x, times=slice(-1, None)),
]


class Place(NamedTuple):
    """Any point inside of all inequalities."""

    barrier: Barrier
    point: Interior

    def stepped(self, which: Tensor = ALL, shift: float = 0.0) -> Newton:
        problem, point = self.barrier.problem, self.point
        scaled = problem._replace(cost=lambda x, u: SCALE[:, None] * problem.cost(x, u))
        local = expand_problem(scaled, point.x, point.u, self.barrier.multipliers(point))
        residual = self.barrier.residual(point)
        return newton(self.barrier, local, point, residual, MU, torch.full((2,), shift), which)


def inside(box: str, cost=quadratic, limits=LIMITS) -> Place:
    bounds = Bounds(*(torch.tensor(side) for side in BOXES[box]))
    x = torch.randn(2, T + 1, 2)
    u = (0.5 * torch.randn(2, T, 2)).clamp(*bounds)
    rows = gather(limits, x, u)
    problem = Problem(sledge, cost, rows, bounds, x[:, 0])
    barrier = Barrier(problem, barrier_rows(rows), SCALE)
    count = len(barrier.rows.sign)
    s, sigma, part, lower, upper = (
        0.1 + torch.rand(2, T + 1 - short, width)
        for short, width in [(0, count), (0, count), (0, count), (1, 2), (1, 2)]
    )
    sigma = torch.where(barrier.yields, sigma, 0.0)
    y = torch.randn(2, T + 1, len(barrier.rows.equality))
    below, above = barrier.gaps(u)
    lower, upper = (
        torch.where(gap.isfinite(), p, 0.0) for gap, p in [(below, lower), (above, upper)]
    )
    point = Interior(x, u, s, sigma, torch.zeros_like(s), y, lower, upper)
    z = torch.where(barrier.yields, 0.9 * part * barrier.spare(point) / 1.1, part)
    return Place(barrier, point._replace(z=torch.where(barrier.rows.applies, z, 0.0)))


@pytest.mark.parametrize("box", BOXES)
def test_a_full_step_meets_all_linear_equations(box: str) -> None:
    barrier, point = place = inside(box)
    found = place.stepped()
    assert (found.shift == 0).all()
    after = point.moved(found.step, torch.ones(2), torch.ones(2))
    for part in barrier.residual(after):
        assert part.abs().max() < 1e-9
    assert torch.equal(after.x[:, 0], point.x[:, 0])
    problem = barrier.problem
    scaled = problem._replace(cost=lambda x, u: SCALE[:, None] * problem.cost(x, u))
    local = expand_problem(scaled, after.x, after.u, barrier.multipliers(after))
    low, high = problem.bounds
    slope = local.gradient - after.lower + after.upper
    assert slope[..., low < high].abs().max() < 1e-9
    assert (found.step.u[..., low == high] == 0).all()


@pytest.mark.parametrize("box", BOXES)
def test_products_are_those_of_the_barrier_to_first_order(box: str) -> None:
    barrier, point = place = inside(box)
    step, rows, mu = place.stepped().step, barrier.rows, MU[:, None, None]
    below, above = barrier.gaps(point.u)
    spare = barrier.spare(point)
    rising = barrier.scale[:, None, None] * rows.quadratic * step.sigma - step.z
    pairs = [
        (point.s, step.s, point.z, step.z, rows.applies),
        (point.sigma, step.sigma, spare, rising, barrier.yields),
        (below, step.u, point.lower, step.lower, below.isfinite()),
        (above, -step.u, point.upper, step.upper, above.isfinite()),
    ]
    for gap, moved, pressure, change, counts in pairs:
        product = gap * pressure + moved * pressure + gap * change
        torch.testing.assert_close(product[counts], mu.expand_as(gap)[counts])
        assert (change[~counts] == 0).all() or pressure is spare
        assert (moved[~counts] == 0).all() or pressure is point.lower or pressure is point.upper


def test_what_is_not_asked_for_does_not_move() -> None:
    place = inside("bounded", bent)
    whole, part = place.stepped(), place.stepped(torch.tensor([False, True]))
    assert (part.step.x[0] == 0).all()
    assert (part.step.u[0] == 0).all()
    assert part.shift[0] == 0
    for one, other in zip(whole.step, part.step, strict=True):
        torch.testing.assert_close(one[1], other[1])


@pytest.mark.parametrize("first", [0.0, 0.01])
def test_a_cost_that_is_not_convex_is_lifted_until_the_step_descends(first: float) -> None:
    """By 1e-4 of its diagonal at first, eight times as much each time, from a shift before on."""
    barrier, point = place = inside("one side open", bent)
    found = place.stepped(shift=first)
    assert (found.shift > 0).all()
    power = torch.log(found.shift / (first or 1e-4)) / torch.log(torch.tensor(8.0))
    torch.testing.assert_close(power, power.round())
    for part in barrier.residual(point.moved(found.step, torch.ones(2), torch.ones(2))):
        assert part.abs().max() < 1e-8


def test_a_step_beside_nothing_goes_all_the_way() -> None:
    """Neither bounds nor inequalities, a hard equality alone."""
    place = inside("open", limits=LIMITS[-1:])
    for size in longest(place.barrier, place.point, place.stepped().step):
        assert torch.equal(size, torch.ones(2))
