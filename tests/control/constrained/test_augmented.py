"""What a compiled solver does with constraints: the same solutions, by rounds in one library."""

import pytest
import torch

from diffstack_mmv.control import ILQR, Batched, Bounds, SolverStatus
from diffstack_mmv.control.compilation import can_compile, kind
from diffstack_mmv.control.constrained import (
    ConstrainedILQR,
    Equality,
    Inequality,
    Slack,
    augmented,
)
from diffstack_mmv.control.expansion import pad_controls
from diffstack_mmv.control.selection import Joined
from tests.control.constrained.problems import braking, drives, solve
from tests.control.constrained.test_solver import BOX, cart, reach, rest

pytestmark = [
    pytest.mark.usefixtures("double"),
    pytest.mark.skipif(not can_compile(), reason="the compiled solver needs a C++ compiler"),
]
COMPILED = ILQR(compile=True)
END = slice(-1, None)


def wall(states, forces, place):
    return states[..., :1] - place[:, None, None]


def brought(solver, place, *more, **settings):
    limits = [Inequality(Batched(wall, place)), *more]
    start = torch.zeros(3, 2), torch.zeros(3, 15, 1)
    solve_in = ConstrainedILQR(solver, **settings)
    return solve_in(Batched(cart), Batched(reach), limits, BOX, *start)


@pytest.mark.parametrize(
    "more",
    [
        [Equality(Batched(rest), times=END)],
        [Equality(Batched(rest), Slack(0.02, 0.05), END)],
    ],
    ids=["hard", "at a price"],
)
def test_rounds_and_interior_points_agree(more):
    place = torch.tensor([1.5, 2.0, 9.0])  # the last wall is out of reach
    with torch.no_grad():
        found, expected = (brought(solver, place, *more) for solver in (COMPILED, ILQR()))
    assert found.converged.all()
    assert float(found.violation.max()) <= 1e-6
    torch.testing.assert_close(found.cost, expected.cost, rtol=1e-6, atol=1e-6)
    torch.testing.assert_close(found.controls, expected.controls, rtol=0, atol=1e-3)
    torch.testing.assert_close(found.multipliers, expected.multipliers, rtol=0, atol=1e-3)


def test_gradients_are_those_of_the_exact_solution():
    place = torch.tensor([1.5, 2.0, 9.0])
    slopes = []
    for solver in (COMPILED, ILQR()):
        leaf = place.clone().requires_grad_()
        solution = brought(solver, leaf, Equality(Batched(rest), times=END))
        slopes.append(torch.autograd.grad(solution.cost.sum() + solution.controls.sum(), leaf)[0])
        assert float(solution.violation.max()) < 1e-12
    torch.testing.assert_close(*slopes, rtol=1e-8, atol=1e-8)


def barred(**settings):
    """Drives, some of which the rounds do not solve."""
    drive = drives(12)
    with torch.no_grad():
        return solve(ConstrainedILQR(COMPILED, **settings), drive, braking(drive))


def test_what_the_rounds_leave_is_told():
    quick = barred(persistent=False)
    left = ~quick.converged
    assert 0 < int(left.sum()) < 6
    told = [SolverStatus.INFEASIBLE, SolverStatus.ITERATION_LIMIT]
    assert torch.isin(quick.status[left], torch.tensor(told)).all()
    assert float(quick.violation[~left].max()) <= 1e-6


def test_what_one_round_leaves_goes_through_the_phases_and_back_to_its_place(monkeypatch):
    monkeypatch.setattr(augmented, "ROUNDS", 1)
    place = torch.tensor([1.5, 9.0, 2.0])  # the second wall is out of reach
    with torch.no_grad():
        quick = brought(COMPILED, place, persistent=False)
        found, expected = (brought(solver, place) for solver in (COMPILED, ILQR()))
    assert quick.converged.tolist() == [False, True, False]
    assert found.converged.all()
    assert float(found.violation.max()) < 1e-9
    torch.testing.assert_close(found.controls, expected.controls, rtol=0, atol=1e-6)
    torch.testing.assert_close(found.multipliers, expected.multipliers, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_what_the_rounds_leave_is_solved_by_persistence():
    quick, whole = barred(persistent=False), barred()
    assert whole.converged.all()
    assert float(whole.violation.max()) <= 1e-6
    assert (quick.controls == whole.controls)[quick.converged].all()


def test_the_cost_of_what_is_left_is_that_of_its_states_and_controls(monkeypatch):
    monkeypatch.setattr(augmented, "ROUNDS", 1)
    price, place = Slack(0.02, 0.05), torch.tensor([1.5, 2.0, 2.5])
    with torch.no_grad():
        found = brought(COMPILED, place, Equality(Batched(rest), price, END), persistent=False)
    assert not found.converged.any()
    excess = rest(found.states, None)[:, -1, 0].abs()
    assert float(excess.min()) > 1e-3
    driven = reach(found.states, pad_controls(found.controls)).sum(-1)
    paid = price.linear * excess + 0.5 * price.quadratic * excess.square()
    torch.testing.assert_close(found.cost, driven + paid, rtol=1e-12, atol=0)


def test_a_problem_that_is_not_finite_is_told_without_nan():
    place = torch.tensor([1.5, torch.nan, 2.5])
    with torch.no_grad():
        found = brought(COMPILED, place, persistent=False)
    assert found.converged.tolist() == [True, False, True]
    assert found.status[1] == SolverStatus.NOT_FINITE
    assert found.cost[1] == found.violation[1] == torch.inf
    assert not any(each.isnan().any() for each in (*found[:-1], *found.multipliers))


def test_a_contradiction_is_infeasible_at_once():
    contrary = Inequality(Batched(lambda x, u: 2.5 - x[..., :1]), times=END)
    limits = [Inequality(Batched(lambda x, u: x[..., :1] - 2)), contrary]
    start = torch.zeros(2, 2), torch.zeros(2, 15, 1)
    box = Bounds(torch.tensor([-9.0]), torch.tensor([9.0]))
    quick = ConstrainedILQR(COMPILED, persistent=False)
    with torch.no_grad():
        found = quick(Batched(cart), Batched(reach), limits, box, *start)
    assert found.infeasible.all()
    torch.testing.assert_close(found.violation, torch.full((2,), 0.25), atol=0.05, rtol=0)


def test_a_joined_function_is_of_the_kind_of_its_parts():
    def call(value):
        return value

    each = [Joined(call, [part], torch.zeros(2)) for part in (wall, rest)]
    assert kind(each[0]) != kind(each[1])
    assert kind(each[0]) == kind(each[0].select(torch.tensor([0])))
