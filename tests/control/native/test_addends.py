"""Sums of like terms: found, and written as a loop that gives what the sum gives."""

import numpy as np
import pytest
import torch

from diffstack_mmv.control import Batched, Bounds
from diffstack_mmv.control.native.addends import addends
from diffstack_mmv.control.native.scalar import Program
from diffstack_mmv.control.native.stages import Sizes, staged
from tests.control.native.test_solver import EXACT, natively, outcome

DOUBLE = torch.float64


def test_addends_of_a_sum_keep_factors_and_conditions():
    program = Program()
    x, p, w = (program.leaf(name, 0) for name in "xpw")
    apply = program.apply
    condition = apply("gt", p, program.constant(0.0))
    inner = apply("add", apply("mul", x, x), apply("sin", x))
    whole = apply(
        "sub", w, apply("where", condition, apply("mul", p, inner), program.constant(0.0))
    )
    own = np.zeros(len(program), dtype=bool)
    own[[p, w, condition, program.constant(0.0)]] = True
    assert len(addends(program, whole, own)) == 3


def among(agents):
    """A point that is pushed away from agents, each problem from others, and its sources."""
    torch.manual_seed(0)
    place = 2 * torch.randn(3, agents, 2, dtype=DOUBLE)
    weight = torch.rand(3, agents, dtype=DOUBLE)
    present = torch.rand(3, agents) < 0.8
    sources = [place.requires_grad_(), weight.requires_grad_()]

    def cost(states, controls, place, weight, present):
        near = states[..., None, :] - place.unsqueeze(-3)
        lack = torch.relu(2.0 - near.square().sum(-1)).square() * weight.unsqueeze(-2)
        pushed = (lack * present.unsqueeze(-2)).sum(-1)
        return 3.0 * pushed + (states - 1).square().sum(-1) + 0.1 * controls.square().sum(-1)

    def step(state, control):
        return state + 0.2 * control

    box = Bounds(*(each * torch.ones(2, dtype=DOUBLE) for each in (-1.0, 1.0)))
    start, guess = torch.zeros(3, 2, dtype=DOUBLE), torch.zeros(3, 6, 2, dtype=DOUBLE)
    return (Batched(step), Batched(cost, *sources, present), box, start, guess), sources


@pytest.mark.parametrize("agents", [12])
def test_solutions_among_many_agents_equal_the_eager_ones(agents):
    arguments, sources = among(agents)
    expected, slopes = outcome(EXACT(*arguments), sources)
    found, others = outcome(natively(EXACT, *arguments), sources)
    assert torch.equal(found.status, expected.status)
    torch.testing.assert_close(found.controls, expected.controls, rtol=1e-7, atol=1e-8)
    torch.testing.assert_close(others, slopes, rtol=1e-6, atol=1e-7)


def test_like_terms_are_one_term_with_numbers_of_its_own():
    program, total = Program(), []
    x = program.leaf("x", 0, 0)
    for k in range(10):
        away = program.apply("sub", x, program.leaf("p", k))
        total.append(program.apply("mul", away, away))
    u = program.leaf("u", 0, 0)
    cost = program.total([*total, program.apply("mul", u, u)])
    problem = staged(program, [x], [cost], Sizes(1, 1, 0, 10))
    (stage,) = problem.costs
    assert stage.repeated is not None
    assert (stage.repeated.count, stage.repeated.term.numbers, stage.own_numbers) == (10, 1, 0)
    assert len(problem.numbers) == 10
