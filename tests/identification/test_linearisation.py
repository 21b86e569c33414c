"""Jacobians of whole tracks against differences of the simulation."""

import pytest
import torch

from diffstack_mmv.identification.linearisation import flat, normal_equations, unflat
from tests.identification.conftest import LIVELY, synthetic_case

STEP = 1e-6


def perturbed(case):
    """Somewhere off the solution: θ, problem, and unknowns with their simulation, gaps closed."""
    theta = case.tracker.parameters.start() + 0.05
    problem = case.data.fitted
    guess = flat(problem.guess)
    moved = unflat(guess + 0.1 * torch.randn(guess.shape), problem.guess.nodes)
    return theta, problem, *case.tracker.drive(theta, problem, moved)


def in_one_piece(case, theta, vector):
    problem = case.data.fitted
    whole = unflat(vector, problem.guess.nodes[:, :0])
    return case.tracker.simulate(theta, problem, whole)


# the synthetic recorder measures steering, which the unicycle does not have
@pytest.mark.parametrize(
    ("dynamics", "known"),
    [("unicycle", False), ("kbm", False), ("kbm", True), ("gm3", False), ("gm3", True)],
)
def test_jacobians_agree_with_differences(dynamics, known):
    extra = {} if dynamics == "unicycle" else {"steer_rate_radps": 1.0}
    case = synthetic_case(dynamics, {}, known, LIVELY[:1], **extra)
    theta, problem, unknowns, now = perturbed(case)
    jacobian = case.tracker.jacobian(theta, problem, unknowns, now)
    begin = flat(unknowns)
    for column in range(0, begin.shape[1], 5):
        step = torch.zeros_like(begin)
        step[:, column] = STEP
        there, back = (
            in_one_piece(case, theta, each).residual for each in (begin + step, begin - step)
        )
        slope = ((there - back) / (2 * STEP)).flatten(1)
        torch.testing.assert_close(jacobian.own[..., column], slope, rtol=1e-4, atol=1e-4)
    for column in range(len(theta)):
        step = STEP * torch.eye(len(theta))[column]
        there, back = (
            in_one_piece(case, each, begin).residual for each in (theta + step, theta - step)
        )
        slope = ((there - back) / (2 * STEP)).flatten(1)
        torch.testing.assert_close(jacobian.shared[..., column], slope, rtol=1e-4, atol=1e-4)


def test_gradient_is_that_of_the_cost():
    case = synthetic_case("kbm", {})
    theta, problem, unknowns, now = perturbed(case)
    arrow = normal_equations(
        case.tracker.jacobian(theta, problem, unknowns, now), now.residual, unknowns
    )

    def cost(vector, theta):
        return in_one_piece(case, theta, vector).cost.sum()

    own, shared = torch.autograd.functional.jacobian(cost, (flat(unknowns), theta))
    torch.testing.assert_close(arrow.own_gradient, own)
    torch.testing.assert_close(arrow.shared_gradient, shared)


def test_without_parameters_only_their_columns_are_left_out():
    case = synthetic_case("kbm", {})
    theta, problem, unknowns, now = perturbed(case)
    whole = case.tracker.jacobian(theta, problem, unknowns, now)
    alone = case.tracker.jacobian(theta, problem, unknowns, now, shared=False)
    torch.testing.assert_close(alone.own, whole.own)
    assert alone.shared.shape[-1] == 0
