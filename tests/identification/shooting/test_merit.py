"""Steps of multiple shooting: what is eliminated, and what is predicted."""

import pytest
import torch
from torch.func import jacrev

from diffstack_mmv.identification.shooting.block_arrowhead import solve_arrowhead
from diffstack_mmv.identification.shooting.merit import (
    LinearisedTracks,
    ShootingStep,
    merit,
    penalty_weights,
    predict_step,
)
from diffstack_mmv.identification.shooting.normal_equations import (
    normal_equations,
    stack_unknowns,
    unstack_unknowns,
)
from tests.identification.conftest import LIVELY, synthetic_problem


def far_from_solution(dynamics="kbm", **options):
    """A problem far from its solution, nodes off the way: setup, θ, unknowns, simulation."""
    setup = synthetic_problem(dynamics, {}, manoeuvres=LIVELY[:2], **options)
    theta, problem = setup.simulator.parameters.start() + 0.05, setup.data.fitted
    guess = problem.guess
    vector = stack_unknowns(guess) + 0.1 * torch.randn(stack_unknowns(guess).shape)
    nodes = guess.nodes + 0.05 * torch.randn(guess.nodes.shape)
    unknowns = unstack_unknowns(vector, nodes)
    return setup, theta, unknowns, setup.simulator.simulate(theta, problem, unknowns)


def newton_step_of(setup, theta, unknowns, now, share=1.0):
    jacobian = setup.simulator.jacobian(theta, setup.data.fitted, unknowns, now)
    closing = torch.full_like(now.cost, share)
    system = normal_equations(jacobian, now.residual, unknowns, closing)
    system = system._replace(shared=system.shared + torch.eye(len(theta)))
    return jacobian, ShootingStep(*solve_arrowhead(system), closing)


def test_condensed_step_solves_the_least_squares_constrained_by_continuity():
    """The whole system with nodes as unknowns and multipliers, assembled by reverse mode."""
    setup, theta, unknowns, now = far_from_solution()
    problem, shape = setup.data.fitted, unknowns.nodes.shape
    jacobian, step = newton_step_of(setup, theta, unknowns, now)
    prediction = predict_step(LinearisedTracks(unknowns, now, jacobian), step)
    sizes = [stack_unknowns(unknowns).numel(), unknowns.nodes.numel(), len(theta)]

    def whole(vector):
        local, nodes, shared = vector.split(sizes)
        cut = unstack_unknowns(local.view(shape[0], -1), nodes.view(shape))
        simulated = setup.simulator.simulate(shared, problem, cut)
        return torch.cat([simulated.residual.flatten(), local]), simulated.gap.flatten()

    begin = torch.cat([stack_unknowns(unknowns).flatten(), unknowns.nodes.flatten(), theta])
    rows, closed = jacrev(whole)(begin)
    residual, gap = whole(begin)
    prior = torch.zeros(len(begin))
    prior[-len(theta) :] = 1.0
    hessian, used = rows.T @ rows + prior.diag(), closed.abs().sum(-1) > 0
    constraint = closed[used]
    zero = torch.zeros(len(constraint), len(constraint))
    system = torch.cat([torch.cat([hessian, constraint.T], 1), torch.cat([constraint, zero], 1)], 0)
    # nodes in the padding move nothing, so the least-norm solution leaves them alone
    right = -torch.cat([rows.T @ residual, gap[used]])
    solution = torch.linalg.lstsq(system, right.unsqueeze(-1), driver="gelsd").solution[:, 0]
    local, nodes, shared = solution[: len(begin)].split(sizes)
    torch.testing.assert_close(step.local.flatten(), local, rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(step.shared, shared, rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(
        (prediction.unknowns.nodes - unknowns.nodes).flatten(), nodes, rtol=1e-5, atol=1e-6
    )


@pytest.mark.parametrize("dynamics", ["kbm", "gm3"])
def test_small_step_leads_where_it_was_predicted(dynamics):
    setup, theta, unknowns, now = far_from_solution(dynamics)
    jacobian, step = newton_step_of(setup, theta, unknowns, now)
    errors = []
    for share in (1e-2, 1e-3):
        part = ShootingStep(*(share * each for each in step))
        prediction = predict_step(LinearisedTracks(unknowns, now, jacobian), part)
        there = setup.simulator.simulate(
            theta + part.shared, setup.data.fitted, prediction.unknowns
        )
        expected = (1 - share) * now.gap
        errors.append(
            float((there.gap - expected).abs().max() + (there.cost - prediction.cost).abs().max())
        )
    assert errors[1] < 0.02 * errors[0]


def test_multipliers_are_the_slope_of_what_follows_by_the_node():
    setup, theta, unknowns, now = far_from_solution()
    problem = setup.data.fitted
    unknowns, now = setup.simulator.simulate_continuous(theta, problem, unknowns)
    jacobian = setup.simulator.jacobian(theta, problem, unknowns, now)
    still = ShootingStep(
        torch.zeros_like(stack_unknowns(unknowns)), torch.zeros_like(theta), torch.zeros(1)
    )
    found = predict_step(LinearisedTracks(unknowns, now, jacobian), still).multipliers
    last = found.shape[1] - 1

    def following(node):
        moved = torch.cat([unknowns.nodes[:, :last], node.unsqueeze(1)], 1)
        return setup.simulator.simulate(theta, problem, unknowns._replace(nodes=moved)).cost.sum()

    slope = torch.autograd.functional.jacobian(following, unknowns.nodes[:, last])
    torch.testing.assert_close(found[:, last], slope)


def test_step_is_a_descent_of_the_merit():
    setup, theta, unknowns, now = far_from_solution()
    jacobian, step = newton_step_of(setup, theta, unknowns, now)
    prediction = predict_step(LinearisedTracks(unknowns, now, jacobian), step)
    weights = penalty_weights(torch.zeros_like(now.gap), prediction.multipliers)
    left = now._replace(cost=prediction.cost, gap=0 * now.gap)
    assert bool((merit(left, weights) < merit(now, weights)).all())


def test_weights_forget_by_halves_but_hold_every_multiplier():
    before, found = torch.tensor([8.0, 1.0, 0.0]), torch.tensor([-2.0, -4.0, 0.5])
    weights = penalty_weights(before.reshape(1, 1, 3), found.reshape(1, 1, 3))
    assert weights.flatten().tolist() == [5.0, 4.0, 0.5]
