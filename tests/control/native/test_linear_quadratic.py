"""Linear-quadratic problems in lanes of eight do what the eager solver does, all by themselves."""

import pytest
import torch

from diffstack_mmv.control import ILQR, Batched, Bounds, SolverStatus
from diffstack_mmv.control.native.capture import Recorder, Trajectory
from diffstack_mmv.control.native.generation import Library, source
from tests.control.native.test_solver import natively

pytestmark = pytest.mark.usefixtures("double")
N, M, STEPS, COUNT = 5, 2, 12, 19
EXACT = ILQR(tolerance=1e-15, one_by_one=1000, max_iterations=200)


def affine(state, control, A, B, b):
    moved = (A * state.unsqueeze(-2)).sum(-1) + (B * control.unsqueeze(-2)).sum(-1)
    return moved + b


def tracking(states, controls, weight, reference):
    """Every time has a place of its own to be at, and none has controls at the end."""
    off = states - reference
    both = (states[..., :M] * controls).sum(-1)
    return off.square().sum(-1) + weight * controls.square().sum(-1) + 0.1 * both


class Problems:
    """Unstable systems, each with its own numbers; some lanes repeat those of others."""

    def __init__(self, seed=0, spread=1.5):
        draw = torch.Generator().manual_seed(seed)

        def normal(*shape):
            return torch.randn(*shape, generator=draw, dtype=torch.float64)

        self.A = torch.eye(N) + spread * 0.3 * normal(COUNT, N, N)
        self.B, self.b = normal(COUNT, N, M), 0.3 * normal(COUNT, N)
        self.weight, self.reference = 0.3 + normal(COUNT, 1).abs(), normal(COUNT, STEPS + 1, N)
        for repeated, other in ((1, 0), (3, 0), (9, 2), (17, 9)):
            for each in (self.A, self.B, self.b, self.weight, self.reference):
                each[repeated] = each[other]
        self.state = 2 * normal(COUNT, N)
        self.leaves = [self.A, self.B, self.b, self.weight, self.reference, self.state]

    def solved(self, solve, low, high, chosen=slice(None), guess=None):
        A, B, b, weight, reference, state = (each[chosen] for each in self.leaves)
        box = Bounds(torch.tensor(low), torch.tensor(high))
        dynamics, cost = Batched(affine, A, B, b), Batched(tracking, weight, reference)
        guess = torch.zeros(len(state), STEPS, M) if guess is None else guess
        return solve(dynamics, cost, box, state, guess)


def by_library(*arguments):
    return natively(EXACT, *arguments)


BOXES = {
    "tight": ([-0.1, -0.2], [0.15, 0.1]),
    "wide": ([-2.0, -2.0], [2.0, 2.0]),
    "one side": ([-torch.inf, -0.3], [0.5, torch.inf]),
    "tied": ([-0.4, 0.25], [0.4, 0.25]),
    "none": ([-torch.inf] * 2, [torch.inf] * 2),
}


@pytest.mark.parametrize("name", BOXES)
def test_solutions_equal_the_eager_ones(name):
    problems = Problems()
    expected = problems.solved(EXACT, *BOXES[name])
    found = problems.solved(by_library, *BOXES[name])
    assert found.converged.all()
    assert expected.converged.all()
    torch.testing.assert_close(found.controls, expected.controls, rtol=1e-7, atol=1e-7)
    torch.testing.assert_close(found.cost, expected.cost, rtol=1e-9, atol=1e-9)
    assert (found.residual < 1e-6 * (1 + found.cost.abs())).all()


@pytest.mark.parametrize("name", ["tight", "one side"])
def test_gradients_equal_the_eager_ones(name):
    problems, slopes = Problems(), []
    for each in problems.leaves:
        each.requires_grad_()
    for solve in (EXACT, by_library):
        solution = problems.solved(solve, *BOXES[name])
        loss = solution.states.sin().sum() + solution.controls.square().sum()
        slopes.append(torch.autograd.grad(loss + 0.3 * solution.cost.sum(), problems.leaves))
    torch.testing.assert_close(slopes[1], slopes[0], rtol=1e-6, atol=1e-6)


def test_a_problem_does_not_depend_on_its_neighbors():
    problems = Problems()
    together = problems.solved(by_library, *BOXES["tight"])
    for i in (0, 8, 18):
        alone = problems.solved(by_library, *BOXES["tight"], slice(i, i + 1))
        torch.testing.assert_close(alone.controls[0], together.controls[i], rtol=0, atol=1e-9)


def test_the_solution_as_a_guess_needs_one_recursion_and_one_step():
    problems = Problems()
    cold = problems.solved(by_library, *BOXES["tight"])
    warm = problems.solved(by_library, *BOXES["tight"], guess=cold.controls)
    assert (cold.iterations > 2).any()
    assert (warm.iterations == 2).all()
    torch.testing.assert_close(warm.controls, cold.controls, rtol=0, atol=1e-10)


def test_active_sets_that_contradict_one_another_are_told_by_the_interior_point():
    """Systems that a control at its bound cannot hold: half of the guesses are wrong at first."""
    found = Problems(seed=1, spread=2.0).solved(by_library, *BOXES["tight"])
    assert found.converged.all()
    assert (found.iterations > 12).any()
    assert (found.iterations < 40).all()
    assert (found.residual < 1e-6 * (1 + found.cost.abs())).all()  # convex: that is the solution


def test_what_is_not_convex_or_not_finite_is_left_to_the_iterations():
    problems = Problems()
    problems.weight[4], problems.weight[11] = -50.0, -50.0
    problems.state[6] = torch.nan
    expected = problems.solved(EXACT, *BOXES["wide"])
    found = problems.solved(by_library, *BOXES["wide"])
    assert torch.equal(found.status, expected.status)
    assert found.status[6] == SolverStatus.NOT_FINITE
    others = [i for i in range(COUNT) if i != 6]
    torch.testing.assert_close(found.cost[others], expected.cost[others], rtol=1e-7, atol=1e-7)


def test_the_number_of_iterations_is_limited():
    problems = Problems()
    box = Bounds(torch.full((M,), -0.1), torch.full((M,), 0.1))
    dynamics = Batched(affine, problems.A, problems.B, problems.b)
    cost = Batched(tracking, problems.weight, problems.reference)
    solver = ILQR(tolerance=1e-15, one_by_one=1000, max_iterations=2)
    found = natively(solver, dynamics, cost, box, problems.state, torch.zeros(COUNT, STEPS, M))
    assert (found.status == SolverStatus.ITERATION_LIMIT).any()


KINKED = {
    "effort by its modulus": lambda x, u: x.square().sum(-1) + u.abs().sum(-1),
    "hinge": lambda x, u: u.square().sum(-1) + (x[..., 0] - 1).relu(),
    "larger of two": lambda x, u: u.square().sum(-1) + torch.maximum(x[..., 0], x[..., 1]),
    "stairs": lambda x, u: u.square().sum(-1) + x[..., 0].floor(),
}


def is_linear_quadratic(dynamics, cost):
    at = Trajectory(torch.zeros(1, 4, 2), torch.zeros(1, 4, 1))
    problem = Recorder()(at, dynamics, cost).problem
    return "#define DMMV_LINEAR_QUADRATIC" in source(problem, Library.SOLVE, "double")


def drift(state, control):
    return state + 0.1 * control


@pytest.mark.parametrize("name", KINKED)
def test_kinks_and_jumps_without_curvature_are_not_linear(name):
    """Their Hessian is that of a quadratic cost, whose minimum was returned as converged."""
    assert not is_linear_quadratic(drift, KINKED[name])


def test_dynamics_that_jump_are_not_linear():
    def stepwise(state, control):
        return state + 0.1 * control.ceil()

    assert not is_linear_quadratic(stepwise, lambda x, u: x.square().sum(-1) + u.square().sum(-1))


def test_what_parameters_choose_stays_linear():
    low = torch.tensor([True, False])

    def chosen(states, controls):
        off = torch.where(low, states, 2 * states) - 1
        return off.square().sum(-1) + 0.1 * controls.square().sum(-1)

    assert is_linear_quadratic(drift, chosen)
