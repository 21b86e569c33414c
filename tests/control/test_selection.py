"""Leaving finished problems behind changes no answer, whatever the callables hold."""

import pytest
import torch

from diffstack_mmv.control import ILQR, Batched, Bounds, DifferencedCurvature
from diffstack_mmv.control.selection import constant, is_shared

BOX = Bounds(torch.tensor([-2.0, -0.4]), torch.tensor([2.0, 0.4]))
SOLVER = ILQR(tolerance=1e-14)
COMPILED = [
    pytest.param(ILQR(tolerance=1e-6, compile=True), marks=pytest.mark.slow),
    pytest.param(
        ILQR(tolerance=1e-6, compile=True, curvature=DifferencedCurvature()), marks=pytest.mark.slow
    ),
]


class Vehicle(torch.nn.Module):
    """Kinematic bicycle with a learnable wheelbase, which all problems share."""

    def __init__(self):
        super().__init__()
        self.wheelbase = torch.nn.Parameter(torch.tensor(1.2))

    def forward(self, state, control):
        x, y, heading, speed = state.unbind(-1)
        turned = heading + 0.1 * speed / self.wheelbase * control[..., 1].tan()
        moved = x + 0.1 * speed * heading.cos(), y + 0.1 * speed * heading.sin()
        return torch.stack([*moved, turned, speed + 0.1 * control[..., 0]], -1)


class SelectableVehicle(Vehicle):
    """The same, which says itself that all problems share it."""

    def select(self, index):
        return self


class Planner(torch.nn.Module):
    """Holds learnable weights; its method is the cost of problems of mixed types of tensors."""

    def __init__(self):
        super().__init__()
        self.weight = torch.nn.Parameter(torch.tensor([0.2, 0.05]))
        self.scale = torch.nn.Embedding(3, 1)
        self.sizes = []

    def objective(self, states, controls, goal, obstacles, valid, kind):
        self.sizes.append(len(kind))
        position = states[..., :2]
        to_goal = (position - goal.unsqueeze(-2)).square().sum(-1)
        away = (position.unsqueeze(-2) - obstacles.unsqueeze(-3)).square().sum(-1)
        bumps = (torch.exp(-2 * away) * valid.unsqueeze(-2)).sum(-1)
        effort = controls.square().sum(-1) * (1 + self.scale(kind).square())
        slow = 0.1 * (states[..., 3] - 2).square()
        return self.weight[0] * to_goal + 0.5 * bumps + self.weight[1] * effort + slow


def problem(count):
    """Tensors of a batch: goal, obstacles, which of them are valid (bool), kind (int64), state."""
    goal = torch.stack([2 + 2 * torch.rand(count), 2 * torch.rand(count) - 1], -1)
    obstacles = goal.unsqueeze(-2) * torch.rand(count, 3, 1)
    valid, kind = torch.rand(count, 3) < 0.6, torch.randint(0, 3, (count,))
    course, speed = torch.rand(count) - 0.5, 1 + torch.rand(count)
    state = torch.stack([0 * course, 0 * course, course, speed], -1)
    return (goal.requires_grad_(), obstacles, valid, kind), state


def gradients(planner, vehicle, goal):
    """All gradients, and none left behind."""
    leaves = planner.weight, planner.scale.weight, vehicle.wheelbase, goal
    found = [leaf.grad.clone() for leaf in leaves]
    for leaf in leaves:
        leaf.grad = None
    return found


def solved(solver, dynamics, cost, state):
    """Solution and, backward, gradients of a number that depends on all of it."""
    box = Bounds(*(bound.to(state) for bound in BOX))
    solution = solver(dynamics, cost, box, state, state.new_zeros(len(state), 12, 2))
    (solution.states.sin().sum() + solution.controls.square().sum()).backward()
    return solution


@pytest.mark.usefixtures("double")
@pytest.mark.parametrize("count", [1, 5, 40])
def test_narrowing_changes_neither_answer_nor_gradient(count):
    tensors, state = problem(count)
    planner, vehicle = Planner(), Vehicle()
    plain = solved(
        SOLVER, vehicle, lambda x, u: planner.objective(x, u, *tensors), state
    )  # a closure cannot be narrowed
    assert set(planner.sizes) == {count}
    expected = gradients(planner, vehicle, tensors[0])
    planner.sizes.clear()
    cost = Batched(planner.objective, *tensors)
    narrowed = solved(SOLVER, Batched(vehicle), cost, state)
    assert plain.converged.all()
    assert (min(planner.sizes) < count) == (count > 8)
    assert narrowed.iterations.equal(plain.iterations)
    torch.testing.assert_close(narrowed, plain, rtol=1e-9, atol=1e-9)
    found = gradients(planner, vehicle, tensors[0])
    torch.testing.assert_close(found, expected, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("count", [1, 20, 40])
@pytest.mark.parametrize("solver", COMPILED)
def test_compiled_answers_and_gradients_equal_the_eager_ones(solver, count):
    tensors, state = problem(count)
    planner, vehicle = Planner(), SelectableVehicle()
    results = []
    for each in (ILQR(tolerance=1e-6), solver):
        solution = solved(each, vehicle, Batched(planner.objective, *tensors), state)
        assert solution.converged.all()
        results.append((solution.controls.detach(), *gradients(planner, vehicle, tensors[0])))
    torch.testing.assert_close(results[1], results[0], rtol=1e-2, atol=5e-3)


@pytest.mark.usefixtures("double")
def test_dynamics_that_select_themselves_need_no_wrapping():
    tensors, state = problem(40)
    planner, vehicle = Planner(), SelectableVehicle()
    cost = Batched(planner.objective, *tensors)
    solved(SOLVER, vehicle, cost, state)
    assert min(planner.sizes) < 40
    assert is_shared(vehicle)
    assert is_shared(Batched(Vehicle()))
    assert not is_shared(Vehicle())
    assert not is_shared(cost)


def test_constant_callables_carry_no_graph_in_their_tensors():
    tensors, _ = problem(3)
    planner = Planner()
    fixed = constant(Batched(planner.objective, *tensors))
    assert not any(tensor.requires_grad for tensor in fixed.tensors)
    assert [tensor.dtype for tensor in fixed.tensors] == [tensor.dtype for tensor in tensors]
    assert planner.weight.requires_grad
    assert constant(planner) is planner


def test_selected_problems_keep_their_types_and_order():
    tensors, _ = problem(6)
    index = torch.tensor([4, 1, 1])
    chosen = Batched(Planner().objective, *tensors).select(index)
    for part, whole in zip(chosen.tensors, tensors, strict=True):
        assert part.dtype == whole.dtype
        assert part.equal(whole[index])


def test_constant_tensors_are_laid_out_as_selected_ones_are():
    wide = torch.rand(4, 3, 5).movedim(-1, 0).requires_grad_()
    plain = constant(Batched(torch.add, wide)).tensors[0]
    assert plain.is_contiguous()
    assert not plain.requires_grad
