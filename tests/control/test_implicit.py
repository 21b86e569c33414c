"""The gradient of a solution is that of the converged solution, not of the iterations."""

from dataclasses import replace

import pytest
import torch

from diffstack_mmv.control import ILQR, Bounds, DifferencedCurvature, ExactCurvature, Unrolled
from tests.control.problems import driving, solve

EXACT = ILQR(tolerance=1e-16)


def functional(solution):
    """A number that depends on every part of the solutions."""
    return (
        solution.states.sin().sum() + solution.controls.square().sum() + 0.3 * solution.cost.sum()
    )


def finite_difference(hidden, name, box, controls, step=1e-5):
    """Central differences of the re-converged solutions along a fixed direction."""
    direction = torch.linspace(-1, 1, hidden[name].numel()).reshape(hidden[name].shape) + 0.3
    values = []
    for sign in (1, -1):
        moved = hidden | {name: hidden[name] + sign * step * direction}
        values.append(functional(solve(EXACT, moved, box, controls)))
    return (values[0] - values[1]) / (2 * step), direction


@pytest.mark.usefixtures("double")
@pytest.mark.parametrize("limit", [50.0, 1.0], ids=["free", "at the bounds"])
@pytest.mark.parametrize("name", ["state", "goal", "weight", "wheelbase"])
def test_gradient_equals_finite_differences(limit, name):
    hidden, box, controls = driving(limit=limit)
    warm = solve(EXACT, hidden, box, controls).controls
    assert ((warm == box.lower) | (warm == box.upper)).any() == (limit < 2)
    hidden[name].requires_grad_()
    functional(solve(EXACT, hidden, box, warm)).backward()
    expected, direction = finite_difference(
        {k: v.detach() for k, v in hidden.items()}, name, box, warm
    )
    torch.testing.assert_close(
        (hidden[name].grad * direction).sum(), expected, rtol=1e-6, atol=1e-8
    )


@pytest.mark.usefixtures("double")
@pytest.mark.parametrize("curvature", [ExactCurvature(), DifferencedCurvature()])
@pytest.mark.parametrize("limit", [50.0, 1.0], ids=["free", "at the bounds"])
def test_unrolled_gradient_approaches_the_implicit_one(limit, curvature):
    hidden, box, controls = driving(limit=limit)
    weight = hidden["weight"].requires_grad_()
    exact = torch.autograd.grad(functional(solve(EXACT, hidden, box, controls)), weight)[0]
    solver = ILQR(tolerance=1e-16, curvature=curvature)
    unrolled = solve(replace(solver, gradient=Unrolled()), hidden, box, controls)
    gradient = torch.autograd.grad(functional(unrolled), weight)[0]
    torch.testing.assert_close(gradient, exact, rtol=1e-4, atol=1e-7)


def test_problem_that_did_not_converge_has_a_gradient_of_zero():
    hidden, box, controls = driving()
    hidden["state"][1] = torch.nan
    hidden["state"].requires_grad_()
    hidden["weight"].requires_grad_()
    solution = solve(ILQR(), hidden, box, controls)
    functional(solution).backward()
    assert (hidden["state"].grad[1] == 0).all()
    assert (hidden["state"].grad[0] != 0).any()
    assert hidden["weight"].grad.isfinite().all()


def test_unconverged_batch_has_a_gradient_of_zero():
    hidden, box, controls = driving()
    hidden["weight"].requires_grad_()
    functional(solve(ILQR(max_iterations=1), hidden, box, controls)).backward()
    assert (hidden["weight"].grad == 0).all()


@pytest.mark.usefixtures("double")
def test_gradient_does_not_depend_on_the_guess():
    hidden, box, controls = driving(limit=1.0)
    weight = hidden["weight"].requires_grad_()
    cold = solve(EXACT, hidden, box, controls)
    warm = solve(EXACT, hidden, box, cold.controls.detach())
    first, second = (torch.autograd.grad(functional(s), weight)[0] for s in (cold, warm))
    torch.testing.assert_close(first, second, rtol=1e-9, atol=1e-12)


def test_nothing_requires_a_gradient_then_neither_does_the_solution():
    hidden, box, controls = driving()
    assert not solve(ILQR(), hidden, box, controls).controls.requires_grad


def graph_nodes(solver):
    """Number of nodes of the graph behind a solution."""
    hidden, box, controls = driving()
    hidden["weight"].requires_grad_()
    todo, seen = [functional(solve(solver, hidden, box, controls)).grad_fn], set()
    while todo:
        node = todo.pop()
        if node is not None and node not in seen:
            seen.add(node)
            todo.extend(following for following, _ in node.next_functions)
    return len(seen)


def test_graph_does_not_grow_with_the_iterations_while_the_unrolled_one_does():
    few, many = ILQR(max_iterations=2), ILQR(max_iterations=50)
    assert graph_nodes(few) == graph_nodes(many)
    assert graph_nodes(replace(many, gradient=Unrolled())) > 2 * graph_nodes(
        replace(few, gradient=Unrolled())
    )


class Pendulum(torch.nn.Module):
    """Knows its own Jacobian, and counts how often it is asked for it."""

    def __init__(self):
        super().__init__()
        self.length = torch.nn.Parameter(torch.tensor(1.0))
        self.asked = 0

    def forward(self, state, control):
        angle, rate = state.unbind(-1)
        rate = rate + 0.1 * (control[..., 0] - 9.81 / self.length * angle.sin())
        return torch.stack([angle + 0.1 * rate, rate], -1)


class LinearisedPendulum(Pendulum):
    def jacobian(self, state, control):
        self.asked += 1
        slope = -0.981 / self.length * state[..., 0].cos()
        one = torch.ones_like(slope)
        A = torch.stack(
            [torch.stack([1 + 0.1 * slope, 0.1 * one], -1), torch.stack([slope, one], -1)], -2
        )
        return A, torch.stack([0.01 * one, 0.1 * one], -1).unsqueeze(-1)


@pytest.mark.usefixtures("double")
def test_a_models_own_jacobian_gives_the_same_solution_and_gradient():
    box = Bounds(torch.tensor([-5.0]), torch.tensor([5.0]))
    results = []
    for model in (Pendulum(), LinearisedPendulum()):
        solution = ILQR(tolerance=1e-14)(
            model,
            lambda x, u: (x[..., 0] - 1).square() + 0.1 * u[..., 0].square(),
            box,
            torch.zeros(3, 2),
            torch.zeros(3, 15, 1),
        )
        solution.controls.sum().backward()
        results.append((solution.controls.detach(), model.length.grad))
    assert model.asked > 0
    torch.testing.assert_close(results[0], results[1])


@pytest.mark.usefixtures("double")
@pytest.mark.parametrize("limit", [50.0, 1.0], ids=["free", "at the bounds"])
def test_gradient_is_exact_where_the_iterations_difference_the_curvature(limit):
    gradients = []
    for solver in (EXACT, ILQR(tolerance=1e-16, curvature=DifferencedCurvature())):
        hidden, box, controls = driving(limit=limit)
        hidden["wheelbase"].requires_grad_()
        functional(solve(solver, hidden, box, controls)).backward()
        gradients.append(hidden["wheelbase"].grad)
    torch.testing.assert_close(*gradients, rtol=1e-7, atol=1e-9)


def test_unrolled_gradient_of_compiled_kernels_is_refused():
    with pytest.raises(ValueError, match=r"`compile` must be false with Unrolled\(\)"):
        ILQR(gradient=Unrolled(), compile=True)
    assert ILQR(gradient=Unrolled()).compiled() == ILQR(gradient=Unrolled())
