"""The implicit gradient is exact on every dynamics model, free and at the bounds."""

import pytest
import torch

from diffstack_mmv.control import ILQR, Bounds
from diffstack_mmv.dynamics import DiffGM3, DiffKBM, ExtendedUnicycle
from diffstack_mmv.types import Motion
from diffstack_mmv.vehicles import load_vehicle

EXACT = ILQR(tolerance=1e-16, max_iterations=200)
VEHICLES = (
    "bicycle",
    "scooter",
    "motorcycle",
    "wheelchair",
    "tricycle",
    "tadpole",
    "skateboard",
    "cart",
    "hoverboard",
)
SIMPLE = [(ExtendedUnicycle, "bicycle"), (DiffKBM, "bicycle"), (DiffKBM, "cart")]
# kind, vehicle, whether bounds are active; DiffGM3 takes the most time: one case of it is fast
CASES = [
    *((kind, vehicle, tight) for kind, vehicle in SIMPLE for tight in (False, True)),
    (DiffGM3, "bicycle", True),
    *(
        pytest.param(DiffGM3, vehicle, tight, marks=pytest.mark.slow)
        for vehicle in VEHICLES
        for tight in (False, True)
        if not (vehicle == "bicycle" and tight)
    ),
]

pytestmark = pytest.mark.usefixtures("double")


def posed(kind, vehicle, tight):
    """Model, cost of its motion, box, hidden tensors and guess; a tight box has active bounds."""
    model = kind(load_vehicle(vehicle)).double()
    lower, upper = (0.25 * bound if tight else 50 * bound for bound in model.bounds)
    zero = torch.zeros(2)
    start = Motion(
        torch.zeros(2, 2), torch.tensor([0.1, -0.3]), torch.tensor([[1.5, 0.0], [1.2, 0.0]]), zero
    )
    hidden = {
        "state": model.initial_state(start).detach(),
        "goal": torch.tensor([[1.8, 0.5], [1.2, -0.6]]),
        "weight": torch.tensor([1.0, 0.3, 0.05]),
        "agent": torch.tensor([[0.8, 0.1], [0.7, 0.0]]),
    }
    return model, Bounds(lower, upper), hidden, torch.zeros(2, 8, 2)


def plan(model, box, hidden, controls):
    """Solve, and reduce the solution to one number."""

    def cost(states, padded):
        motion = model.motion(states, padded)
        away = (motion.position - hidden["agent"].unsqueeze(-2)).square().sum(-1)
        to_goal = (motion.position - hidden["goal"].unsqueeze(-2)).square().sum(-1)
        scaled = padded / model.bounds.upper
        w = hidden["weight"]
        return w[0] * to_goal + w[1] * torch.exp(-2 * away) + w[2] * scaled.square().sum(-1)

    solution = EXACT(model, cost, box, hidden["state"], controls)
    assert solution.converged.all()
    return solution, solution.states.sin().sum() + solution.controls.square().sum()


def is_touching(controls, box):
    """Whether any control lies on a bound."""
    return bool(((controls == box.lower) | (controls == box.upper)).any())


def error_along_a_direction(model, box, hidden, guess, tensors, step=3e-6):
    """Relative error of the derivative along a direction against a central difference.

    Both sides of the difference are re-converged solutions. Its error is of second order in the
    step; for the weights of the skateboard at its bounds 2e-5 at a step of 1e-5.
    """
    directions = [torch.linspace(0.5, 1, t.numel()).reshape(t.shape) for t in tensors]
    results = []
    with torch.no_grad():
        for sign in (1, -1):
            originals = [tensor.clone() for tensor in tensors]
            for tensor, direction in zip(tensors, directions, strict=True):
                tensor.add_(sign * step * direction)
            results.append(plan(model, box, hidden, guess)[1])
            for tensor, original in zip(tensors, originals, strict=True):
                tensor.copy_(original)
    expected = (results[0] - results[1]) / (2 * step)
    found = sum((t.grad * d).sum() for t, d in zip(tensors, directions, strict=True))
    return float((found - expected).abs() / expected.abs().clamp_min(1e-3))


def solved_with_gradient(kind, vehicle, tight):
    """Model, box, hidden tensors with their gradients, and the converged controls."""
    model, box, hidden, controls = posed(kind, vehicle, tight)
    with torch.no_grad():
        guess = plan(model, box, hidden, controls)[0].controls
    hidden = {name: value.requires_grad_() for name, value in hidden.items()}
    plan(model, box, hidden, guess)[1].backward()
    return model, box, hidden, guess


@pytest.mark.parametrize(("kind", "vehicle", "tight"), CASES)
def test_gradient_equals_finite_differences(kind, vehicle, tight):
    model, box, hidden, guess = solved_with_gradient(kind, vehicle, tight)
    assert is_touching(guess, box) == tight
    groups = {name: [value] for name, value in hidden.items()}
    groups["parameters"] = [value for value in model.parameters() if value.grad is not None]
    for name, tensors in groups.items():
        if tensors:
            error = error_along_a_direction(model, box, hidden, guess, tensors)
            assert error < 1e-5, name
