"""Newton's method from a point on: which controls are free, and how far a step is."""

import pytest
import torch
from torch import Tensor

from diffstack_mmv.control import Batched, Bounds
from diffstack_mmv.control.constrained.local import Problem
from diffstack_mmv.control.constrained.newton import Polished, PrimalDual, free_controls, polish
from tests.control.constrained.test_progress import carts

pytestmark = pytest.mark.usefixtures("double")


@pytest.mark.parametrize(
    ("place", "slope", "free"),
    [
        (-1.0, 0.3, False),
        (-1.0, -0.3, True),  # the cost pulls it off the bound
        (-1.0, 0.0, True),  # reached without pressure
        (2.0, -0.3, False),
        (2.0, 0.3, True),
        (0.5, 0.3, True),
        (0.5, -0.3, True),
    ],
)
def test_a_control_is_held_by_a_bound_that_it_is_pressed_on(
    place: float, slope: float, free: bool
) -> None:
    problem, controls = carts([0.0])
    problem = problem._replace(bounds=Bounds(torch.tensor([-1.0]), torch.tensor([2.0])))
    u, gradient = torch.full_like(controls, place), torch.full_like(controls, slope)
    assert (free_controls(problem, u, gradient) == free).all()


@pytest.mark.parametrize("slope", [-1.0, 0.0, 1.0])
def test_a_control_between_equal_bounds_is_never_free(slope: float) -> None:
    problem, controls = carts([0.0])
    problem = problem._replace(bounds=Bounds(torch.tensor([0.0]), torch.tensor([0.0])))
    assert not free_controls(problem, controls, torch.full_like(controls, slope)).any()


def polished(unit: float, chosen: tuple[bool, ...]) -> tuple[Problem, Polished]:
    """Carts far from the wall, from the guess of no force, at a cost of squares in a unit."""

    def near(states: Tensor, forces: Tensor) -> Tensor:
        return unit * (1 + (states[..., 0] - 1).square() + 0.1 * forces[..., 0].square())

    problem, controls = carts([0.9] * len(chosen))
    problem = problem._replace(cost=Batched(near))
    none, one = torch.zeros_like(problem.rows.linear), torch.tensor(1e-12)
    start, weight = PrimalDual(controls, none), torch.ones_like(none[:, :1])
    return problem, polish(problem, start, weight, torch.tensor(chosen), one, 1e6 * one)


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_squares_are_solved_by_one_step_in_any_unit_of_the_cost(unit: float) -> None:
    problem, found = polished(unit, (True,))
    u = found.point.u.clone().requires_grad_()
    acting = torch.nn.functional.pad(u, (0, 0, 0, 1))
    (slope,) = torch.autograd.grad(problem.cost(problem.rollout(u), acting).sum(), u)
    assert found.solved.all()
    assert found.steps.tolist() == [3]  # the first one, and two that are none
    assert slope.abs().max() < 1e-12 * unit


@pytest.mark.parametrize("chosen", [(True, False), (False, True), (False, False)])
def test_problems_that_are_not_chosen_stay_where_they_are(chosen: tuple[bool, bool]) -> None:
    _, found = polished(1.0, chosen)
    assert found.solved.tolist() == list(chosen)
    assert [bool(each.any()) for each in found.point.u] == list(chosen)
    assert (found.steps > 0).tolist() == list(chosen)
