"""Gradients of constrained solutions are those of the solutions, the active constraints fixed."""

import pytest
import torch

from diffstack_mmv.control import ILQR, Batched, Bounds
from diffstack_mmv.control.constrained import ConstrainedILQR, Equality, Inequality, Slack
from diffstack_mmv.types import map_tensors
from tests.control.constrained.problems import (
    Drive,
    box,
    braking,
    constraints,
    drives,
    price,
    solve,
)
from tests.control.constrained.problems import step as bicycle

pytestmark = pytest.mark.usefixtures("double")
EXACT = ConstrainedILQR(ILQR(tolerance=1e-16))
DRIVES = 2


def functional(solution):
    """A number that depends on every part of each solution."""
    pressed = sum(multiplier.sum((-2, -1)) for multiplier in solution.multipliers)
    moved = solution.states.sin().sum((-2, -1)) + solution.controls.square().sum((-2, -1))
    return moved + 0.3 * solution.cost + 0.1 * pressed


@pytest.fixture(scope="module")
def solved():
    """Drives and their solutions, as warm start of all derivatives."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    with torch.no_grad():
        drive = drives(DRIVES)
        solution = solve(EXACT, drive, braking(drive))
    torch.set_default_dtype(before)
    return drive, solution


QUICK = ("state", "radius", "wheelbase")
SLOW = [name for name in Drive._fields if name not in QUICK]


@pytest.mark.parametrize(
    "name", [*QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)]
)
def test_gradient_equals_central_differences(solved, name):
    drive, start = solved
    assert start.converged.all()
    warm = start.controls, start.multipliers
    hidden = getattr(drive, name).clone().requires_grad_()
    found = functional(solve(EXACT, drive._replace(**{name: hidden}), *warm))
    gradient = torch.autograd.grad(found.sum(), hidden)[0]
    direction = torch.linspace(-1, 1, hidden.numel()).reshape(hidden.shape) + 0.3
    values = []
    for step in (1e-5, -1e-5):
        moved = drive._replace(**{name: hidden.detach() + step * direction})
        values.append(functional(solve(EXACT, moved, *warm)).detach())
    expected = (values[0] - values[1]) / 2e-5
    along = (gradient * direction).reshape(DRIVES, -1).sum(1)
    torch.testing.assert_close(along, expected, rtol=2e-6, atol=1e-7)


def cart(state, force):
    place, speed = state.unbind(-1)
    return torch.stack([place + 0.1 * speed, speed + 0.1 * force[..., 0]], -1)


def reach(states, forces):
    return (states[..., 0] - 3).square() + 0.01 * forces[..., 0].square()


HIDDEN = {"wall": 2.0, "end": 0.1, "price": 0.4, "slope": 3.0, "lower": -6.0, "upper": 4.0}


def brought(slack_of, **hidden):
    """A cart to a wall at a given last speed; each number may be changed."""
    given = {name: torch.tensor(value) for name, value in HIDDEN.items()} | hidden

    def wall(states, forces):
        return states[..., :1] - given["wall"]

    def end(states, forces):
        return states[..., 1:] - given["end"]

    limits = [
        Inequality(wall, slack_of(given), slice(5, None)),
        Equality(end, times=slice(-1, None)),
    ]
    box = Bounds(given["lower"].reshape(1), given["upper"].reshape(1))
    return EXACT(cart, reach, limits, box, torch.zeros(2), torch.zeros(15, 1))


SLACKS = {
    "hard": lambda given: Slack(torch.tensor(torch.inf)),
    "linear": lambda given: Slack(linear=given["price"]),
    "both": lambda given: Slack(given["price"], given["slope"]),
    "quadratic": lambda given: Slack(quadratic=given["slope"]),
}


@pytest.mark.parametrize(
    ("slack", "name"),
    [("hard", "wall"), ("hard", "upper"), ("linear", "price"), ("both", "slope")]
    + [
        pytest.param(*case, marks=pytest.mark.slow)
        for case in (("hard", "end"), ("hard", "lower"), ("both", "price"), ("quadratic", "slope"))
    ],
)
def test_gradient_by_prices_bounds_and_constraints(slack, name):
    hidden = torch.tensor(HIDDEN[name], requires_grad=True)
    solution = brought(SLACKS[slack], **{name: hidden})
    assert solution.converged
    gradient = torch.autograd.grad(functional(solution), hidden)[0]
    values = [
        functional(brought(SLACKS[slack], **{name: hidden.detach() + step})).detach()
        for step in (1e-5, -1e-5)
    ]
    expected = (values[0] - values[1]) / 2e-5
    torch.testing.assert_close(gradient, expected, rtol=1e-6, atol=1e-7)


def test_weakly_active_constraint_counts_as_inactive():
    """The wall stands exactly where the cart ends without it: the derivative is that side's."""
    still = Bounds(torch.tensor([-9.0]), torch.tensor([9.0]))

    def ended(goal, wall):
        def cost(states, forces):
            return (states[..., 0] - goal).square() + 0.01 * forces[..., 0].square()

        def limit(states, forces):
            return states[..., :1] - wall

        limits = [Inequality(limit)]
        return EXACT(cart, cost, limits, still, torch.zeros(2), torch.zeros(15, 1))

    farthest = ended(torch.tensor(3.0), torch.tensor(1e3)).states[:, 0].max()
    goal, wall = (x.clone().requires_grad_() for x in (torch.tensor(3.0), farthest))
    solution = ended(goal, wall)
    assert solution.converged
    of_goal, of_wall = torch.autograd.grad(functional(solution), (goal, wall))
    inner = functional(ended(goal.detach() - 1e-5, farthest)) - functional(solution)
    assert of_wall.abs() < 1e-9
    torch.testing.assert_close(of_goal, -inner.detach() / 1e-5, rtol=1e-4, atol=1e-6)


def test_problem_that_did_not_converge_has_a_gradient_of_zero():
    drive = drives(3)
    drive.goal[1] = torch.nan
    radius, state = drive.radius.requires_grad_(), drive.state.requires_grad_()
    solution = solve(EXACT, drive, torch.zeros(3, 10, 2))
    functional(solution).sum().backward()
    assert (radius.grad[1] == 0).all()
    assert (state.grad[1] == 0).all()
    assert (state.grad[0] != 0).any()


def test_problem_that_did_not_converge_leaves_the_gradient_of_what_all_share_to_its_mates():
    drive = drives(3)
    drive.goal[1] = torch.nan

    def slope(drive):
        shared = torch.tensor(1.0, requires_grad=True)

        def cost(states, controls, *own):
            return shared * price(states, controls, *own) + controls.square().sum(-1)

        start = torch.zeros(len(drive.goal), 10, 2)
        problem = Batched(bicycle, drive.wheelbase), Batched(cost, drive.goal, drive.weight)
        solution = EXACT(*problem, constraints(drive), box(), drive.state, start)
        return torch.autograd.grad(solution.controls.square().sum(), shared)[0]

    mates = map_tensors(lambda part: part[[0, 2]], drive)
    torch.testing.assert_close(slope(drive), slope(mates))


def test_infeasible_problem_has_a_gradient_of_zero():
    place = torch.tensor([[0.0, 0.0], [9.0, 0.0]], requires_grad=True)
    limits = [Inequality(lambda states, forces: states[..., :1] - 2)]
    box = Bounds(torch.tensor([-9.0]), torch.tensor([9.0]))
    solution = EXACT(cart, reach, limits, box, place, torch.zeros(2, 15, 1))
    assert solution.infeasible.tolist() == [False, True]
    functional(solution).sum().backward()
    assert (place.grad[1] == 0).all()
    assert (place.grad[0] != 0).any()


@pytest.mark.parametrize("part", ["cost", "states", "controls"])
def test_a_second_derivative_is_refused_and_not_wrong(solved, part):
    drive, start = solved
    radius = drive.radius.clone().requires_grad_()
    found = solve(EXACT, drive._replace(radius=radius), start.controls, start.multipliers)
    slope = torch.autograd.grad(getattr(found, part).sum(), radius, create_graph=True)[0]
    with pytest.raises(RuntimeError, match="be differentiated once"):
        torch.autograd.grad(slope.sum() + radius.square().sum(), radius)


def test_nothing_requires_a_gradient_then_neither_does_the_solution():
    assert not brought(SLACKS["hard"]).controls.requires_grad
