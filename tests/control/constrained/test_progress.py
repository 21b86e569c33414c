"""What is kept of problems that are not solved, and what counts as solved without a gradient."""

import pytest
import torch

from diffstack_mmv.control import Batched, Bounds
from diffstack_mmv.control.constrained import ConstrainedILQR, Inequality, Slack
from diffstack_mmv.control.constrained.constraint import gather
from diffstack_mmv.control.constrained.local import Problem
from diffstack_mmv.control.constrained.newton import PrimalDual
from diffstack_mmv.control.constrained.progress import Merit, begin, judge
from diffstack_mmv.types import SolverStatus
from tests.control.constrained.problems import (
    Drive,
    braking,
    constraints,
    drives,
    price,
    solve,
    step,
)

END = slice(-1, None)
TOLERANCE = 1e-6


def cart(state, force):
    place, speed = state.unbind(-1)
    return torch.stack([place + 0.1 * speed, speed + 0.1 * force[..., 0]], -1)


def reach(states, controls):
    return (states[..., 0] - 3).square() + 0.01 * controls.square().sum(-1)


def wall(drive):
    """A wall across the way, on which the drive ends, and the limits on speed and grip."""

    def beyond(states, controls, goal):
        length = goal.norm(dim=-1)[..., None]
        along = (states[..., :2] * (goal / length).unsqueeze(-2)).sum(-1)
        return (along - 0.6 * length).unsqueeze(-1)

    later = slice(1, None)
    return [*constraints(drive)[1:], Inequality(Batched(beyond, drive.goal), times=later)]


def carts(place, price=torch.inf):
    """Carts that want to go to 3 and may go to 2, each standing at a place."""
    limit = Inequality(Batched(lambda x, u: x[..., :1] - 2), times=END, slack=Slack(linear=price))
    state = torch.tensor([[each, 0.0] for each in place])
    controls = torch.zeros(len(place), 10, 1)
    box = Bounds(torch.tensor([-9.0]), torch.tensor([9.0]))
    rows = gather([limit], state.unsqueeze(-2).expand(-1, 11, -1), controls)
    return Problem(Batched(cart), Batched(reach), rows, box, state), controls


@pytest.mark.parametrize(
    ("mine", "theirs", "worse"),
    [
        ((0.0, 2.0), (0.0, 1.0), True),
        ((0.0, 1.0), (0.0, 1.0), False),
        ((0.0, 1.0), (0.0, 2.0), False),
        ((1e-7, 1.0), (0.0, 2.0), False),
        ((1e-7, 2.0), (0.0, 1.0), True),
        ((0.2, 1.0), (0.1, 2.0), True),
        ((0.1, 2.0), (0.2, 1.0), False),
        ((torch.inf, torch.inf), (0.2, 1.0), True),
        ((0.2, 1.0), (torch.inf, torch.inf), False),
        ((torch.inf, torch.inf), (torch.inf, torch.inf), False),
    ],
)
def test_the_violation_counts_before_the_cost(mine, theirs, worse):
    pair = (Merit(*(torch.tensor([part]) for part in each)) for each in (mine, theirs))
    assert bool(next(pair).exceeds(next(pair), TOLERANCE)) is worse


@pytest.mark.parametrize(("price", "violation", "paid"), [(torch.inf, 0.5, 0.0), (4.0, 0.0, 2.0)])
def test_a_hard_violation_is_told_and_a_soft_one_paid(price, violation, paid):
    problem, controls = carts([2.5], price)
    merit = judge(problem, controls)
    torch.testing.assert_close(merit.violation, torch.tensor([violation]))
    torch.testing.assert_close(merit.cost, torch.tensor([11 * 0.25 + paid]))


@pytest.mark.parametrize("value", [torch.nan, torch.inf, 1e30])
def test_what_is_not_finite_is_never_kept(value):
    problem, controls = carts([0.0, 1.0])
    progress = begin(problem, controls)
    lost = PrimalDual(torch.full_like(controls, value), progress.multipliers)
    kept = progress.offered(problem, lost, TOLERANCE)
    assert torch.equal(kept.u, controls)
    assert kept.merit.cost.isfinite().all()


def test_a_motion_that_ends_nowhere_is_no_good_even_if_no_part_of_the_problem_sees_it():
    problem, controls = carts([0.0])
    problem = problem._replace(cost=Batched(lambda x, u: x[..., 0].square()))
    controls[:, -1] = torch.inf  # of the speed at the end
    assert problem.cost(problem.rollout(controls), controls).isfinite().all()
    assert all(part.isinf().all() for part in judge(problem, controls))


def test_a_cost_that_is_no_number_is_infinite():
    problem, controls = carts([0.0])
    lost = problem._replace(cost=Batched(lambda x, u: torch.nan * x[..., 0]))
    assert judge(lost, controls).cost.isposinf().all()


def test_the_better_point_of_each_open_problem_is_kept():
    problem, controls = carts([0.0, 1.0, 0.0])
    pushed = torch.zeros_like(controls)
    pushed[:, 0] = torch.tensor([[5.0], [-5.0], [5.0]])
    point = PrimalDual(pushed, torch.ones_like(problem.rows.linear))
    progress = begin(problem, controls)
    done = torch.tensor([False, False, True])
    progress = progress.finished(done, PrimalDual(controls, point.multipliers), SolverStatus(0))
    kept = progress.offered(problem, point, TOLERANCE)
    assert torch.equal(kept.u[0], pushed[0])
    assert torch.equal(kept.u[1:], controls[1:])
    assert kept.multipliers.flatten(1).amax(1).tolist() == [1.0, 0.0, 1.0]
    assert not kept.is_open[2]


def test_iterations_count_for_open_problems_alone():
    problem, controls = carts([0.0, 1.0])
    progress = begin(problem, controls)
    point = PrimalDual(controls, progress.multipliers)
    once = progress.counted(torch.tensor([3, 4]))
    done = once.finished(torch.tensor([False, True]), point, SolverStatus.CONVERGED)
    assert done.counted(torch.tensor([10, 20])).iterations.tolist() == [13, 4]


def standing_still(drive):
    return torch.zeros_like(braking(drive))


@pytest.mark.usefixtures("double")
@pytest.mark.parametrize("guess", [braking, standing_still])
def test_at_the_limit_of_iterations_the_best_controls_are_returned(guess):
    """Not the guess, which is as far from a solution as ever."""
    drive = drives(6)
    controls = guess(drive)
    with torch.no_grad():
        found = solve(ConstrainedILQR(max_iterations=12), drive, controls)
    left = found.status == SolverStatus.ITERATION_LIMIT
    assert left.sum() > 1
    states = [drive.state]
    for control in controls.unbind(1):
        states.append(step(states[-1], control, drive.wheelbase))
    states, acting = torch.stack(states, 1), torch.nn.functional.pad(controls, (0, 0, 0, 1))
    before = price(states, acting, drive.goal, drive.weight).sum(-1)
    assert found.violation[left].max() < 0.05
    assert (found.cost < 0.9 * before)[left].all()


@pytest.mark.usefixtures("double")
@pytest.mark.parametrize(("seed", "known"), [(4, False), (5, True)])
def test_single_precision_solves_what_rounding_keeps_newton_from(seed, known):
    """So many times are at the wall, with next to no pressure, that it cannot be told which."""
    solver, exact = ConstrainedILQR(max_iterations=60), drives(1, seed=seed)
    torch.set_default_dtype(torch.float32)
    drive = Drive(*(part.float() for part in exact))
    with torch.no_grad():
        found = solve(solver, drive, braking(drive), wanted=wall)
    assert found.converged.all()
    # a gradient needs the active constraints: where they are not known there is none
    place = drive.goal.clone().requires_grad_()
    told = solve(solver, drive._replace(goal=place), braking(drive), wanted=wall)
    (gradient,) = torch.autograd.grad(told.states.sum(), place)
    assert bool(told.converged) is known
    assert bool((gradient != 0).any()) is known

    torch.set_default_dtype(torch.float64)
    for each in (found, told):
        with torch.no_grad():
            best = solve(solver, exact, each.controls.detach().double(), wanted=wall)
        assert best.converged.all()
        torch.testing.assert_close(each.cost.detach().double(), best.cost, rtol=3e-5, atol=0)
