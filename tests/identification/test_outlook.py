"""Steps of multiple shooting: what is eliminated, and what is promised."""

import pytest
import torch
from torch.func import jacrev

from diffstack_mmv.identification.arrow import solve
from diffstack_mmv.identification.linearisation import flat, normal_equations, unflat
from diffstack_mmv.identification.outlook import Linearised, Step, foresee, merit, penalty_weights
from tests.identification.conftest import LIVELY, synthetic_case


def scattered(dynamics="kbm", **options):
    """A problem far from its solution, nodes off the way: case, θ, unknowns, simulation."""
    case = synthetic_case(dynamics, {}, manoeuvres=LIVELY[:2], **options)
    theta, problem = case.tracker.parameters.start() + 0.05, case.data.fitted
    guess = problem.guess
    vector = flat(guess) + 0.1 * torch.randn(flat(guess).shape)
    nodes = guess.nodes + 0.05 * torch.randn(guess.nodes.shape)
    unknowns = unflat(vector, nodes)
    return case, theta, unknowns, case.tracker.simulate(theta, problem, unknowns)


def newton(case, theta, unknowns, now, share=1.0):
    jacobian = case.tracker.jacobian(theta, case.data.fitted, unknowns, now)
    closing = torch.full_like(now.cost, share)
    arrow = normal_equations(jacobian, now.residual, unknowns, closing)
    arrow = arrow._replace(shared=arrow.shared + torch.eye(len(theta)))
    return jacobian, Step(*solve(arrow), closing)


def test_condensed_step_solves_the_least_squares_constrained_by_continuity():
    """The whole system with nodes as unknowns and multipliers, assembled by reverse mode."""
    case, theta, unknowns, now = scattered()
    problem, shape = case.data.fitted, unknowns.nodes.shape
    jacobian, step = newton(case, theta, unknowns, now)
    outlook = foresee(Linearised(unknowns, now, jacobian), step)
    sizes = [flat(unknowns).numel(), unknowns.nodes.numel(), len(theta)]

    def whole(vector):
        own, nodes, shared = vector.split(sizes)
        cut = unflat(own.view(shape[0], -1), nodes.view(shape))
        simulated = case.tracker.simulate(shared, problem, cut)
        return torch.cat([simulated.residual.flatten(), own]), simulated.gap.flatten()

    begin = torch.cat([flat(unknowns).flatten(), unknowns.nodes.flatten(), theta])
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
    own, nodes, shared = solution[: len(begin)].split(sizes)
    torch.testing.assert_close(step.own.flatten(), own, rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(step.shared, shared, rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(
        (outlook.unknowns.nodes - unknowns.nodes).flatten(), nodes, rtol=1e-5, atol=1e-6
    )


@pytest.mark.parametrize("dynamics", ["kbm", "gm3"])
def test_small_step_leads_where_it_was_foreseen(dynamics):
    case, theta, unknowns, now = scattered(dynamics)
    jacobian, step = newton(case, theta, unknowns, now)
    errors = []
    for share in (1e-2, 1e-3):
        part = Step(*(share * each for each in step))
        outlook = foresee(Linearised(unknowns, now, jacobian), part)
        there = case.tracker.simulate(theta + part.shared, case.data.fitted, outlook.unknowns)
        expected = (1 - share) * now.gap
        errors.append(
            float((there.gap - expected).abs().max() + (there.cost - outlook.cost).abs().max())
        )
    assert errors[1] < 0.02 * errors[0]


def test_multipliers_are_the_slope_of_what_follows_by_the_node():
    case, theta, unknowns, now = scattered()
    problem = case.data.fitted
    unknowns, now = case.tracker.drive(theta, problem, unknowns)
    jacobian = case.tracker.jacobian(theta, problem, unknowns, now)
    still = Step(torch.zeros_like(flat(unknowns)), torch.zeros_like(theta), torch.zeros(1))
    found = foresee(Linearised(unknowns, now, jacobian), still).multipliers
    last = found.shape[1] - 1

    def following(node):
        moved = torch.cat([unknowns.nodes[:, :last], node.unsqueeze(1)], 1)
        return case.tracker.simulate(theta, problem, unknowns._replace(nodes=moved)).cost.sum()

    slope = torch.autograd.functional.jacobian(following, unknowns.nodes[:, last])
    torch.testing.assert_close(found[:, last], slope)


def test_step_is_a_descent_of_the_merit():
    case, theta, unknowns, now = scattered()
    jacobian, step = newton(case, theta, unknowns, now)
    outlook = foresee(Linearised(unknowns, now, jacobian), step)
    weights = penalty_weights(torch.zeros_like(now.gap), outlook.multipliers)
    left = now._replace(cost=outlook.cost, gap=0 * now.gap)
    assert bool((merit(left, weights) < merit(now, weights)).all())


def test_weights_forget_by_halves_but_hold_every_multiplier():
    before, found = torch.tensor([8.0, 1.0, 0.0]), torch.tensor([-2.0, -4.0, 0.5])
    assert penalty_weights(before, found).tolist() == [5.0, 4.0, 0.5]
