"""Jacobians of whole tracks against differences of the simulation."""

import pytest
import torch

from diffstack_mmv.identification.shooting.normal_equations import (
    normal_equations,
    stack_unknowns,
    unstack_unknowns,
)
from tests.identification.conftest import LIVELY, synthetic_problem

STEP = 1e-6


def perturbed(setup):
    """Somewhere off the solution: θ, problem, and unknowns with their simulation, gaps closed."""
    theta = setup.simulator.parameters.start() + 0.05
    problem = setup.data.fitted
    guess = stack_unknowns(problem.guess)
    moved = unstack_unknowns(guess + 0.1 * torch.randn(guess.shape), problem.guess.nodes)
    return theta, problem, *setup.simulator.simulate_continuous(theta, problem, moved)


def as_one_interval(setup, theta, vector):
    problem = setup.data.fitted
    whole = unstack_unknowns(vector, problem.guess.nodes[:, :0])
    return setup.simulator.simulate(theta, problem, whole)


# the synthetic recorder measures steering, which the unicycle does not have
@pytest.mark.parametrize(
    ("dynamics", "known"),
    [("unicycle", False), ("kbm", False), ("kbm", True), ("gm3", False), ("gm3", True)],
)
def test_jacobians_agree_with_differences(dynamics, known):
    extra = {} if dynamics == "unicycle" else {"steer_rate_radps": 1.0}
    setup = synthetic_problem(dynamics, {}, known, LIVELY[:1], **extra)
    theta, problem, unknowns, now = perturbed(setup)
    jacobian = setup.simulator.jacobian(theta, problem, unknowns, now)
    begin = stack_unknowns(unknowns)
    for column in range(0, begin.shape[1], 11):
        step = torch.zeros_like(begin)
        step[:, column] = STEP
        there, back = (
            as_one_interval(setup, theta, each).residual for each in (begin + step, begin - step)
        )
        slope = ((there - back) / (2 * STEP)).flatten(1)
        torch.testing.assert_close(jacobian.local[..., column], slope, rtol=1e-4, atol=1e-4)
    for column in range(len(theta)):
        step = STEP * torch.eye(len(theta))[column]
        there, back = (
            as_one_interval(setup, each, begin).residual for each in (theta + step, theta - step)
        )
        slope = ((there - back) / (2 * STEP)).flatten(1)
        torch.testing.assert_close(jacobian.shared[..., column], slope, rtol=1e-4, atol=1e-4)


def test_gradient_is_that_of_the_cost():
    setup = synthetic_problem("kbm", {})
    theta, problem, unknowns, now = perturbed(setup)
    system = normal_equations(
        setup.simulator.jacobian(theta, problem, unknowns, now), now.residual, unknowns
    )

    def cost(vector, theta):
        return as_one_interval(setup, theta, vector).cost.sum()

    local, shared = torch.autograd.functional.jacobian(cost, (stack_unknowns(unknowns), theta))
    torch.testing.assert_close(system.local_gradient, local)
    torch.testing.assert_close(system.shared_gradient, shared)


def test_without_parameters_only_their_columns_are_left_out():
    setup = synthetic_problem("kbm", {})
    theta, problem, unknowns, now = perturbed(setup)
    whole = setup.simulator.jacobian(theta, problem, unknowns, now)
    alone = setup.simulator.jacobian(theta, problem, unknowns, now, shared=False)
    torch.testing.assert_close(alone.local, whole.local)
    assert alone.shared.shape[-1] == 0
