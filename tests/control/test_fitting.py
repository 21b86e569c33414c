"""What the callables of a problem have to return."""

import functools
import re

import pytest
import torch

from diffstack_mmv.control import ILQR, Batched, Bounds
from diffstack_mmv.control.constrained import ConstrainedILQR, Inequality

STATE, CONTROLS = torch.zeros(3, 2), torch.zeros(3, 8, 1)
BOX = Bounds(-torch.ones(1), torch.ones(1))
WEIGHT = torch.ones(3)
REST = BOX, STATE, CONTROLS


def step(state, control):
    position, speed = state.unbind(-1)
    return torch.stack([position + 0.1 * speed, speed + 0.1 * control[..., 0]], -1)


def fitting(states, controls, weight):
    return weight[:, None] * (states[..., 0] - 1).square() + controls[..., 0].square()


def one_per_problem(states, controls, weight):
    return fitting(states, controls, weight).sum(-1, keepdim=True)


def jerky(states, controls, weight):
    jerk = controls[..., 1:, 0] - controls[..., :-1, 0]
    return fitting(states, controls, weight) + torch.nn.functional.pad(jerk, (0, 1)).square()


def jerky_since(states, controls, weight):
    jerk = controls[..., 1:, 0] - controls[..., :-1, 0]
    return fitting(states, controls, weight) + torch.nn.functional.pad(jerk, (1, 0)).square()


def summed_up(states, controls, weight):
    return fitting(states, controls, weight).cumsum(-1)


def cut_off(states, controls, weight):
    return fitting(states.detach(), controls.detach(), weight)


def towards_the_end(states, controls, weight):
    return fitting(states, controls, weight) + (states - states[..., -1:, :]).square().sum(-1)


def of_other_precision(states, controls, weight):
    return fitting(states, controls, weight).double()


OF_OTHER_TIMES = "`cost` must depend at each time on state and control of that time alone"
BAD = {
    one_per_problem: r"`cost` must return the shape \(3, 9\)",
    jerky: OF_OTHER_TIMES,
    jerky_since: OF_OTHER_TIMES,
    summed_up: OF_OTHER_TIMES,
    towards_the_end: OF_OTHER_TIMES,
    cut_off: "`cost` must be differentiable in state or control",
    of_other_precision: "`cost` must return torch.float32 as the state, but got torch.float64",
}


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("form", [Batched, functools.partial])
@pytest.mark.parametrize("cost", BAD)
def test_a_cost_that_does_not_fit_is_refused_after_one_that_does(form, cost):
    """Wrapped callables share their type, and were told apart by nothing else."""

    def wrapped(function):
        return form(function, WEIGHT) if form is Batched else form(function, weight=WEIGHT)

    assert ILQR()(step, wrapped(fitting), BOX, STATE, CONTROLS).converged.all()
    with pytest.raises(ValueError, match=BAD[cost]):
        ILQR()(step, wrapped(cost), BOX, STATE, CONTROLS)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("dynamics", "told"),
    [
        (lambda x, u: step(x, u).double(), "return torch.float32"),
        (lambda x, u: step(x, u).detach(), "be differentiable in state or control"),
    ],
    ids=["of other precision", "cut off from their arguments"],
)
def test_dynamics_that_do_not_fit_are_refused(dynamics, told):
    cost = functools.partial(fitting, weight=WEIGHT)
    with pytest.raises(ValueError, match=f"`dynamics` must {told}"):
        ILQR()(dynamics, cost, BOX, STATE, CONTROLS)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("missing", ["dynamics", "cost"])
def test_what_cannot_be_called_is_named(missing):
    cost = functools.partial(fitting, weight=WEIGHT)
    given = {"dynamics": step, "cost": cost, missing: None}
    needs = f"`{missing}` must be a function or a module, but got NoneType"
    with pytest.raises(TypeError, match=needs):
        ILQR()(given["dynamics"], given["cost"], BOX, STATE, CONTROLS)


def branching(state, control):
    return step(state, control) if (state[..., 1] < 1).all() else state + 0 * control


def reading(state, control):
    return step(state, control) * max(1.0, state.max().item())


def writing(state, control):
    following = torch.zeros(state.shape)
    following[..., 0] += step(state, control)[..., 0]
    return following


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("dynamics", [branching, reading, writing])
def test_what_cannot_be_called_for_many_times_at_once_is_refused_with_the_remedy(dynamics):
    cost = functools.partial(fitting, weight=WEIGHT)
    with pytest.raises(
        ValueError, match=r"`dynamics` must be one that torch.vmap can call.*Write torch\.where"
    ):
        ILQR()(dynamics, cost, BOX, STATE, CONTROLS)


def advancing(state, control):
    position, speed = state.unbind(-1)
    position += 0.1 * speed
    return torch.stack([position, speed + 0.1 * control[..., 0]], -1)


def growing(states, controls):
    states[..., 0] += controls[..., 0]
    return states[..., 0].square() + controls[..., 0].square()


@pytest.mark.usefixtures("unchecked")
def test_what_writes_into_its_arguments_is_refused_before_it_reaches_those_of_the_caller():
    cost = functools.partial(fitting, weight=WEIGHT)
    start = torch.ones_like(STATE)
    refused = "must leave its arguments as they are.*Join new columns by torch.stack"
    with pytest.raises(ValueError, match=f"`dynamics` {refused}"):
        ILQR()(advancing, cost, BOX, start, CONTROLS)
    assert torch.equal(start, torch.ones_like(STATE))
    with pytest.raises(ValueError, match=f"`cost` {refused}"):
        ILQR()(step, growing, BOX, start, CONTROLS)
    wall = Inequality(lambda states, controls: growing(states, controls).unsqueeze(-1))
    with pytest.raises(ValueError, match=rf"`constraints\[0\]` {refused}"):
        ConstrainedILQR()(step, cost, [wall], BOX, start, CONTROLS)


@pytest.mark.usefixtures("unchecked")
def test_a_cost_and_a_constraint_that_branch_are_refused_as_well():
    def dear(states, controls):
        return fitting(states, controls, WEIGHT) * (2 if (states > 1).any() else 1)

    with pytest.raises(
        ValueError, match=r"`cost` must be one that torch.vmap can call.*control flow'\. Write"
    ):
        ILQR()(step, dear, BOX, STATE, CONTROLS)
    cost = functools.partial(fitting, weight=WEIGHT)
    wall = Inequality(lambda states, controls: states[..., :1] - (2 if (states > 1).any() else 1))
    with pytest.raises(
        ValueError, match=r" must be one that torch.vmap can call.*control flow'\. Write"
    ):
        ConstrainedILQR()(step, cost, [wall], BOX, STATE, CONTROLS)


def test_nothing_is_refused_where_autograd_is_off():
    cost = functools.partial(lambda x, u, weight: fitting(x, u, weight), weight=WEIGHT)
    with torch.inference_mode():
        assert ILQR()(lambda x, u: step(x, u), cost, BOX, STATE, CONTROLS).converged.all()


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("transform", "told"), [(torch.func.grad, "Grad"), (torch.func.vmap, "Vmap")]
)
def test_transforms_of_a_whole_solve_are_refused(transform, told):
    def end(weight):
        cost = functools.partial(fitting, weight=weight.expand(3))
        return ILQR()(step, cost, BOX, STATE, CONTROLS).cost.sum()

    given = torch.tensor(1.0) if transform is torch.func.grad else torch.ones(2)
    with pytest.raises(ValueError, match=f"`ILQR` must be called outside of torch.func.*{told}"):
        transform(end)(given)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_costs_of_one_time_are_accepted_at_any_scale(scale):
    """Weights that change over time make no cost depend on other times."""
    ramp = scale * torch.linspace(0, 1, 9).exp()
    cost = functools.partial(lambda x, u, weight: ramp * fitting(x, u, weight), weight=WEIGHT)
    assert ILQR()(step, cost, BOX, STATE, CONTROLS).converged.all()


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("weight", "error", "told"),
    [
        (torch.ones(1), ValueError, "one entry for each of 3 problems, but got shape (1,)"),
        (torch.tensor(1.0), ValueError, "but got shape (). Let the function hold what all"),
        (1.0, TypeError, "be a tensor, but got float"),
    ],
)
def test_named_tensors_are_of_every_problem_in_every_solve(weight, error, told):
    """Each solve: the first one may have had other tensors, and has all open till its end."""
    assert ILQR()(step, Batched(fitting, WEIGHT), BOX, STATE, CONTROLS).converged.all()

    def shared(states, controls, weight):
        return fitting(states, controls, WEIGHT) * torch.as_tensor(weight)

    with pytest.raises(error, match=f"`cost.tensors` must .*{re.escape(told)}"):
        ILQR()(step, Batched(shared, weight), *REST)
    with pytest.raises(error, match=re.escape(told)):
        ILQR()(Batched(lambda x, u, _: step(x, u), weight), Batched(fitting, WEIGHT), *REST)


def test_named_tensors_of_a_constraint_are_of_every_problem():
    wall = Batched(lambda states, controls, place: states[..., :1] - place, torch.ones(1, 1, 1))
    cost = Batched(fitting, WEIGHT)
    with pytest.raises(ValueError, match=r"one entry for each of 3 problems, but got shape \(1, 1"):
        ConstrainedILQR()(step, cost, [Inequality(wall)], BOX, STATE, CONTROLS)
