"""The expansion of a constrained problem, against derivatives through the whole motion."""

import pytest
import torch
from torch import Tensor

from diffstack_mmv.control import Batched
from diffstack_mmv.control.constrained.condensed import condense
from diffstack_mmv.control.constrained.constraint import gather
from diffstack_mmv.control.constrained.local import Problem, expand_problem
from diffstack_mmv.control.expansion import pad_controls
from tests.control.constrained.problems import box, constraints, drives, price, step

pytestmark = pytest.mark.usefixtures("double")
COUNT, STEPS = 2, 4


def posed() -> tuple[Problem, Tensor]:
    """Drives past moving discs, and controls that are no solution."""
    drive, controls = drives(COUNT), 0.3 * torch.randn(COUNT, STEPS, 2)
    standing = drive.state.unsqueeze(1).expand(-1, STEPS + 1, -1)
    rows = gather(constraints(drive), standing, controls)
    dynamics, cost = Batched(step, drive.wheelbase), Batched(price, drive.goal, drive.weight)
    return Problem(dynamics, cost, rows, box(), drive.state), controls


def rows_of(problem: Problem, controls: Tensor) -> Tensor:
    return problem.rows.values(problem.rollout(controls), pad_controls(controls))


@pytest.mark.parametrize("pressing", [0.0, 1.0], ids=["the cost alone", "with constraints"])
def test_its_slope_and_curvature_are_those_of_the_lagrangian_along_the_motion(
    pressing: float,
) -> None:
    problem, controls = posed()
    multipliers = pressing * torch.randn_like(problem.rows.linear)

    def lagrangian(u: Tensor) -> Tensor:
        cost = problem.cost(problem.rollout(u), pad_controls(u))
        return cost.sum() + (multipliers * rows_of(problem, u)).sum()

    found = expand_problem(problem, problem.rollout(controls), controls, multipliers)
    torch.testing.assert_close(found.gradient, torch.func.grad(lagrangian)(controls))
    hessian = torch.func.hessian(lagrangian)(controls).flatten(4).flatten(1, 2)
    for number, curvature in enumerate(condense(found).hessian):
        torch.testing.assert_close(curvature, hessian[number, :, number])


def test_its_rows_move_as_those_of_the_motion_do() -> None:
    problem, controls = posed()
    found = expand_problem(
        problem, problem.rollout(controls), controls, torch.zeros_like(problem.rows.linear)
    )
    slopes = torch.func.jacrev(lambda u: rows_of(problem, u))(controls)
    for number, jacobian in enumerate(condense(found).jacobian):
        expected = slopes[number, :, :, number].flatten(2).flatten(0, 1)
        torch.testing.assert_close(jacobian, expected)


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_its_magnitude_is_that_of_the_cost_and_its_noise_a_rounding_of_it(unit: float) -> None:
    problem, controls = posed()
    problem = problem._replace(cost=Batched(lambda x, u: -unit * (x[..., 0] + 2).square()))
    x = problem.rollout(controls)
    found = expand_problem(problem, x, controls, torch.zeros_like(problem.rows.linear))
    size = unit * (x[..., 0] + 2).square().sum(-1)
    torch.testing.assert_close(found.magnitude, size)
    share = found.noise / found.magnitude / torch.finfo(x.dtype).eps
    assert ((share >= 1) & (share < 10)).all()
