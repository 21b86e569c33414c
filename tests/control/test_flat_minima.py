"""Minima that are flat in some control, and what is asked of a solution besides its gradient."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from diffstack_mmv.control import ILQR, Batched, Bounds, Unrolled
from diffstack_mmv.control.box_qp import regular_inverse
from diffstack_mmv.dynamics import DiffKBM
from diffstack_mmv.types import SolverStatus
from diffstack_mmv.vehicles import load_vehicle

pytestmark = pytest.mark.usefixtures("double")
STEPS = 20


def double_integrator(state, control):
    position, speed = state.unbind(-1)
    return torch.stack([position + 0.1 * speed, speed + 0.1 * control[..., 0]], -1)


def box(limit, m=1):
    return Bounds(torch.full((m,), -limit), torch.full((m,), limit))


def reach(goal, effort=0.01):
    return lambda x, u: (
        (x[..., 0] - goal).square() + 0.1 * x[..., 1].square() + effort * u[..., 0].square()
    )


@pytest.mark.parametrize("compiled", [False, True])
def test_a_vehicle_at_rest_at_its_goal_has_a_gradient(compiled):
    """Steering does nothing there, and costs nothing: no batch mate may lose its gradient by it."""
    model = DiffKBM(load_vehicle("bicycle")).double()
    weight = torch.tensor(0.1, requires_grad=True)
    goal = torch.tensor([[0.0, 0.0], [5.0, 1.0]], requires_grad=True)

    def cost(x, u, goal):
        return (x[..., :2] - goal[:, None]).square().sum(-1) + weight * u[..., 0].square()

    def gradients(goal):
        start, guess = torch.zeros(len(goal), 4), torch.zeros(len(goal), STEPS, 2)
        solver = ILQR(compile=compiled)
        solution = solver(model, Batched(cost, goal), model.bounds, start, guess)
        assert solution.converged.all()
        return torch.autograd.grad(solution.states[:, -1].sum(), (goal, weight))

    both, alone = gradients(goal), gradients(goal[1:])
    assert all(each.isfinite().all() for each in both)
    torch.testing.assert_close(both[0][1], alone[0][0])
    assert both[0][0, 0] > 1  # it follows its goal ahead, and cannot follow it sideways
    assert both[0][0, 1] == 0


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
@pytest.mark.parametrize("place", [0.0, 3.0, 1000.0])
def test_at_rest_at_its_goal_a_cost_of_nothing_is_reached(place, dtype, compiled):
    """The cost falls to zero but for the rounding of the places, far below that of the guess."""
    state, guess = torch.tensor([[place, 0.0]], dtype=dtype), torch.full((1, STEPS, 1), 0.1)
    bounds = Bounds(*(bound.to(dtype) for bound in box(3.0)))
    solver = ILQR(compile=compiled)
    solution = solver(double_integrator, reach(place), bounds, state, guess.to(dtype))
    assert solution.converged.all()
    assert int(solution.iterations) < 15
    assert solution.controls.abs().max() <= 1e3 * max(place, 1) * torch.finfo(dtype).eps


@pytest.mark.parametrize(("m", "compiled"), [(2, False), (3, False), (3, True)])
def test_a_control_that_does_nothing_changes_no_gradient(m, compiled):
    goal = torch.tensor([2.0], requires_grad=True)

    def gradient(m):
        cost = Batched(lambda x, u, goal: reach(goal[:, None])(x, u), goal)
        guess = torch.zeros(1, STEPS, m)
        solver = ILQR(tolerance=1e-16, compile=compiled)
        solution = solver(Batched(double_integrator), cost, box(3.0, m), torch.zeros(1, 2), guess)
        return torch.autograd.grad(solution.states.square().sum(), goal)[0]

    torch.testing.assert_close(gradient(m), gradient(1))


@pytest.mark.parametrize("compiled", [False, True])
def test_without_any_effort_the_reached_goal_is_followed(compiled):
    """All controls but two are flat: the terminal cost does not care how its goal is reached."""
    goal = torch.tensor([1.0], requires_grad=True)

    def cost(x, u, goal):
        last = torch.arange(x.shape[-2]) == x.shape[-2] - 1
        return last * (1 + (x[..., 0] - goal[:, None]).square() + x[..., 1].square())

    solver, guess = ILQR(compile=compiled), torch.zeros(1, STEPS, 1)
    problem = Batched(double_integrator), Batched(cost, goal)
    solution = solver(*problem, box(50.0), torch.zeros(1, 2), guess)
    slope = torch.autograd.grad(solution.states[0, -1].sum(), goal)[0]
    torch.testing.assert_close(slope, torch.ones(1))


@given(m=st.integers(1, 5), seed=st.integers(0, 10_000), rank=st.integers(0, 5))
def test_what_has_an_inverse_is_inverted(m, seed, rank):
    """H⁺ H H⁺ = H⁺, and H H⁺ H = H of the free rows, as long as what is left out is zero."""
    generator = torch.Generator().manual_seed(seed)
    factor = torch.randn(m, min(rank, m), 7, generator=generator, dtype=torch.float64)
    H = torch.einsum("ikn,jkn->ijn", factor, factor)
    free = torch.rand(m, 7, generator=generator) < 0.8
    found = regular_inverse(H, free, torch.full((m, 7), 1e-9, dtype=torch.float64))
    kept = torch.where(free.unsqueeze(0) & free.unsqueeze(1), H, 0.0).movedim(-1, 0)
    inverse = found.movedim(-1, 0)
    assert (inverse[~free.T] == 0).all()
    torch.testing.assert_close(kept @ inverse @ kept, kept, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("compiled", [False, True])
def test_no_value_depends_on_whether_a_gradient_is_asked_for(compiled):
    """The cost of a problem that overflows is infinite, or the best of many starts would be it."""
    goal = torch.tensor([0.0, 0.0], requires_grad=True)

    def explosive(x, u):
        position, speed = double_integrator(x, u).unbind(-1)
        return torch.stack([position, speed * (1 + 0.05 * x[..., 0].square().exp())], -1)

    cost = Batched(
        lambda x, u, g: (x[..., 0] - g[:, None]).square() + 0.1 * u[..., 0].square(), goal
    )
    start = torch.tensor([[0.0, 1.0]]).expand(2, 2)
    guess = torch.tensor([-1.0, 1.0])[:, None, None].expand(2, STEPS, 1)
    solver = ILQR(compile=compiled)
    solution = solver(Batched(explosive), cost, box(1.0), start, guess)
    with torch.no_grad():
        plain = solver(Batched(explosive), cost, box(1.0), start, guess)
    assert solution.status[1] == SolverStatus.NOT_FINITE
    assert solution.cost.argmin() == 0
    for name in ("cost", "states", "controls"):
        assert torch.equal(getattr(solution, name), getattr(plain, name))


@pytest.mark.parametrize(
    ("part", "compiled"),
    [
        ("cost", False),
        ("states", False),
        ("controls", False),
        pytest.param("states", True, marks=pytest.mark.slow),
    ],
)
def test_bounds_have_a_gradient(part, compiled):
    def solved(lower, upper):
        solver, guess = ILQR(tolerance=1e-16, compile=compiled), torch.zeros(1, STEPS, 1)
        bounds = Bounds(lower, upper)
        found = solver(double_integrator, reach(2.0), bounds, torch.zeros(1, 2), guess)
        assert (found.controls == upper).any()
        assert (found.controls == lower).any()
        return getattr(found, part)

    bounds = torch.tensor([-1.5], requires_grad=True), torch.tensor([1.0], requires_grad=True)
    assert torch.autograd.gradcheck(solved, bounds, eps=1e-5, atol=1e-5)


def second_derivative(solver, part):
    """Of the sum of the squares of a part of the solution by the goal."""
    goal = torch.tensor(2.0, requires_grad=True)
    guess = torch.zeros(1, STEPS, 1)
    solution = solver(double_integrator, reach(goal), box(50.0), torch.zeros(1, 2), guess)
    value = getattr(solution, part).square().sum()
    slope = torch.autograd.grad(value, goal, create_graph=True)[0]
    assert slope.isfinite()
    return torch.autograd.grad(slope, goal)[0]


@pytest.mark.parametrize("part", ["cost", "states"])
def test_a_second_derivative_is_refused_and_not_wrong(part):
    with pytest.raises(RuntimeError, match=r"be differentiated once.*gradient=Unrolled"):
        second_derivative(ILQR(), part)


def test_iterations_that_are_kept_have_a_second_derivative():
    assert second_derivative(ILQR(gradient=Unrolled()), "states").isfinite()
