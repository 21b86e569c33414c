"""A problem with NaN or infinite entries never touches its batch mates."""

from functools import cache, partial

import pytest
import torch

from diffstack_mmv.control import ILQR, Batched, Bounds
from tests.control.problems import driving, goal_cost, rate_model

BAD = 2
VALUES = (float("nan"), float("inf"), float("-inf"))
PLACES = ("state", "goal", "guess", "wheelbase")


def answered(place, value, solver=None, device="cpu"):
    """Solution and gradient to the goals of six problems, one of which is broken in a place."""
    hidden, box, guess = driving()
    hidden = {name: tensor.clone().to(device) for name, tensor in hidden.items()}
    hidden["wheelbase"] = hidden["wheelbase"].expand(6).clone()
    guess = guess.clone().to(device)
    parts = {"state": hidden["state"], "goal": hidden["goal"], "guess": guess}
    parts["wheelbase"] = hidden["wheelbase"]
    if place is not None:
        parts[place][BAD] = value
    goal = hidden["goal"].requires_grad_()
    bounds = Bounds(box.lower.to(device), box.upper.to(device))
    solution = (solver or ILQR())(
        rate_model(hidden["wheelbase"]), goal_cost(goal, hidden["weight"]), bounds,
        hidden["state"], guess,
    )  # fmt: skip
    others = torch.arange(6) != BAD
    solution.controls[others.to(device)].square().sum().backward()
    return solution, goal.grad, others.to(device)


clean_answer = cache(partial(answered, None, 0.0))


def check(place, value, **options):
    clean, clean_gradient, others = clean_answer(**options)
    found, gradient, _ = answered(place, value, **options)
    assert torch.equal(found.controls[others], clean.controls[others])
    assert torch.equal(found.states[others], clean.states[others])
    assert torch.equal(found.status[others], clean.status[others])
    assert torch.equal(gradient[others], clean_gradient[others])
    # an infinite guess is brought into the box, an infinite wheelbase only drives straight on
    if value != value or (place in ("state", "goal") and abs(value) == float("inf")):
        assert not found.converged[BAD]


@pytest.mark.parametrize("value", VALUES)
@pytest.mark.parametrize("place", PLACES)
def test_a_broken_problem_leaves_its_mates_alone(place, value):
    check(place, value)


@pytest.mark.slow
@pytest.mark.parametrize("value", [*VALUES[:2], 300.0])
@pytest.mark.parametrize("place", PLACES)
def test_a_broken_problem_leaves_its_mates_alone_compiled(place, value):
    check(place, value, solver=ILQR(compile=True))


def driven(goal, wheelbase, state, solver):
    """Controls of a batch that can be narrowed, and the gradient of those that are finite."""
    weight = driving()[0]["weight"]
    goal = goal.clone().requires_grad_()
    solution = solver(
        Batched(lambda x, u, wheelbase: rate_model(wheelbase)(x, u), wheelbase),
        Batched(lambda x, u, goal: goal_cost(goal, weight)(x, u), goal),
        driving()[1], state, state.new_zeros(len(state), 12, 2),
    )  # fmt: skip
    solution.controls[solution.converged].square().sum().backward()
    return solution.controls.detach(), goal.grad


@pytest.mark.parametrize(
    "solver", [ILQR(), pytest.param(ILQR(compile=True), marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("value", [float("nan"), 300.0])
@pytest.mark.parametrize("count", [32, 12])
def test_broken_problems_that_are_left_behind_early_leave_their_mates_alone(solver, value, count):
    hidden = driving((count,))[0]
    hidden["goal"][::3] *= 6  # harder
    parts = hidden["goal"], hidden["wheelbase"].expand(count).clone()
    clean = driven(*parts, hidden["state"], solver)
    state = hidden["state"].clone()
    state[: count - 7] = value
    broken = driven(*parts, state, solver)
    for found, expected in zip(broken, clean, strict=True):
        assert found[-7:].equal(expected[-7:])


@pytest.mark.parametrize("broken", [(BAD,), (0, BAD, 5)])
@pytest.mark.parametrize(
    ("place", "value"),
    [
        *((place, value) for place in ("state", "goal") for value in VALUES),
        ("wheelbase", VALUES[0]),
    ],
)
def test_broken_problems_leave_the_gradient_of_what_all_share_to_their_mates(place, value, broken):
    hidden = driving()[0]
    hidden["wheelbase"] = hidden["wheelbase"].expand(6).clone()
    hidden[place][list(broken)] = value

    def slope(chosen):
        weight = hidden["weight"].clone().requires_grad_()
        state, goal, wheelbase = (hidden[name][chosen] for name in ("state", "goal", "wheelbase"))
        solution = ILQR()(
            Batched(lambda x, u, wheelbase: rate_model(wheelbase)(x, u), wheelbase),
            Batched(lambda x, u, goal: goal_cost(goal, weight)(x, u), goal),
            driving()[1], state, torch.zeros(len(chosen), 12, 2),
        )  # fmt: skip
        slope = torch.autograd.grad(solution.controls.square().sum(), weight)[0]
        return slope, solution.converged.tolist()

    whole, kept = list(range(6)), [at for at in range(6) if at not in broken]
    (together, converged), (alone, _) = slope(whole), slope(kept)
    assert converged == [at in kept for at in whole]
    torch.testing.assert_close(together, alone)


@pytest.mark.gpu
@pytest.mark.parametrize("value", VALUES)
@pytest.mark.parametrize("place", PLACES)
def test_a_broken_problem_leaves_its_mates_alone_on_a_gpu(place, value):
    check(place, value, device="cuda")
