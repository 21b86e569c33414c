"""Derivatives: exact, finite, and available to every transform a solver uses."""

import math

import pytest
import torch
from torch.func import functional_call, grad, jacfwd, jacrev, vmap

from diffstack_mmv.dynamics import DiffGM3, rollout
from diffstack_mmv.dynamics.gm3 import ConsistentBrush, DiffGM3WheelSpeed, PaperBrush, SharpBrush
from diffstack_mmv.types import Motion
from diffstack_mmv.vehicles import load_vehicle, vehicle_names

NAMES = vehicle_names()
LAWS = {"consistent": ConsistentBrush, "paper": PaperBrush}
# both laws for one vehicle; the law of the paper for the others in the slow tests
VEHICLES_AND_LAWS = [
    pytest.param(
        name, law, marks=[] if law == "consistent" or name == "bicycle" else pytest.mark.slow
    )
    for name in NAMES
    for law in LAWS
]
# a second derivative takes seconds: three layouts of wheels, the others in the slow tests
LAYOUTS = ("bicycle", "tricycle", "wheelchair")
LAYOUTS_AND_LAWS = [
    each if each.values[0] in LAYOUTS else pytest.param(*each.values, marks=pytest.mark.slow)
    for each in VEHICLES_AND_LAWS
]

# position, v_x, v_y, heading, r, lean, lean rate | a, steer
EDGES = {
    "rest": ([0, 0, 0, 0, 0, 0, 0, 0], [0.05, 0.02]),
    "rest, full brake": ([0, 0, 0, 0, 0, 0, 0, 0], [-6, 0.6]),
    "straight": ([1, 2, 4, 0, 0.3, 0, 0, 0], [0.3, 0.0]),
    "turn": ([1, 2, 5, 0.1, 0.3, 0.6, 0.2, 0.1], [0.4, 0.2]),
    "full brake": ([0, 0, 6, 0.1, 0, 0.3, 0.1, 0], [-9, 0.6]),
    "full slide": ([0, 0, 5, 4, 0, 2, 0.1, 0], [3, -1.5]),
    "reverse": ([0, 0, -2, 0.1, 0, 0.2, 0, 0], [-1, 0.1]),
    "inner wheel in the air": ([0, 0, 8, 0.2, 0, 3, 0.3, 0], [1, 0.5]),
}


@pytest.mark.parametrize("edge", EDGES)
@pytest.mark.parametrize(("name", "law"), VEHICLES_AND_LAWS)
def test_step_has_exact_gradients(name, law, edge):
    model = DiffGM3(load_vehicle(name), tire=LAWS[law]()).double()
    state, control = (torch.tensor(values).double().requires_grad_() for values in EDGES[edge])
    offsets = [p for p in model.parameters() if p.requires_grad]
    names = [key for key, p in model.named_parameters() if p.requires_grad]

    def step(state, control, *values):
        return functional_call(model, dict(zip(names, values, strict=True)), (state, control))

    # the brush law has a kink in its second derivative at zero slip, which sets the tolerance
    torch.autograd.gradcheck(
        step, (state, control, *offsets), eps=1e-6, rtol=1e-3, atol=2e-3, fast_mode=True
    )


def wild(count):
    """States and controls far outside of the normal range, some entries tiny or zero."""
    torch.manual_seed(2)
    spread = torch.tensor([100, 100, 60, 60, 20, 40, 6, 60, 200, 20]).double()
    values = (2 * torch.rand(count, 10).double() - 1) * spread
    kind = torch.rand(count, 10)
    values = torch.where(kind < 0.1, torch.zeros_like(values), values)
    values = torch.where((kind > 0.1) & (kind < 0.3), values * 1e-4, values)
    return values[:, :8], values[:, 8:]


def finite(*tensors):
    return all(bool(torch.isfinite(tensor).all()) for tensor in tensors)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", NAMES)
def test_wild_inputs_give_finite_values_and_gradients(name, law, dtype):
    model = DiffGM3(load_vehicle(name), tire=LAWS[law]()).to(dtype)
    state, control = (part.to(dtype).requires_grad_() for part in wild(6000))
    end, rate = model(state, control), model.derivative(state, control)
    learned = [p for p in model.parameters() if p.requires_grad]
    gradients = torch.autograd.grad((end + rate).sum(), [state, control, *learned])
    assert finite(end, rate, *gradients)


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", NAMES)
def test_a_hundred_thousand_wild_inputs_stay_finite(name, law):
    model = DiffGM3(load_vehicle(name), tire=LAWS[law]()).double()
    state, control = (part.requires_grad_() for part in wild(100_000))
    end = model(state, control)
    assert finite(end, *torch.autograd.grad(end.sum(), [state, control]))


def curvature(model):
    """Hessian of a weighted sum of the next state, as a solver takes it: forward over reverse."""
    weight = torch.linspace(-1, 1, 8).double()

    def value(state, control):
        return (model(state, control) * weight).sum()

    return vmap(jacfwd(grad(value, (0, 1)), (0, 1)))


@pytest.mark.parametrize(("name", "law"), LAYOUTS_AND_LAWS)
def test_second_derivatives_are_exact_and_finite(name, law):
    model = DiffGM3(load_vehicle(name), tire=LAWS[law]()).double()
    state, control = (torch.tensor(part).double()[None] for part in EDGES["turn"])
    (by_state, _), _ = curvature(model)(state, control)
    first = vmap(grad(lambda x, u: (model(x, u) * torch.linspace(-1, 1, 8).double()).sum()))
    shift = 1e-5 * torch.eye(8).double()
    numeric = (
        first(state + shift, control.expand(8, 2)) - first(state - shift, control.expand(8, 2))
    ) / 2e-5
    assert torch.allclose(by_state[0], numeric, rtol=1e-4, atol=1e-4)
    wildly, rest = wild(300), (torch.zeros(1, 8).double(), torch.zeros(1, 2).double())
    for inputs in (wildly, rest):
        blocks = curvature(model)(*inputs)
        assert finite(*blocks[0], *blocks[1])


@pytest.mark.parametrize("name", ["bicycle", "wheelchair", "skateboard"])
def test_transforms_agree(name):
    model = DiffGM3(load_vehicle(name)).double().requires_grad_(False)
    state, control = wild(20)
    assert torch.allclose(vmap(model)(state, control), model(state, control), atol=1e-9)
    forward, backward = (
        vmap(transform(model, (0, 1)))(state, control) for transform in (jacfwd, jacrev)
    )
    assert all(torch.allclose(a, b, atol=1e-7) for a, b in zip(forward, backward, strict=True))


@pytest.mark.parametrize("name", NAMES)
def test_vehicle_at_rest_learns_to_start(name):
    model = DiffGM3(load_vehicle(name)).double()
    control = torch.zeros(2).double().requires_grad_()
    end = model(torch.zeros(8).double(), control)
    (push,) = torch.autograd.grad(end[2], control)
    assert push[0].item() == pytest.approx(0.05, rel=0.01)  # slope 1/2 of the split


@pytest.mark.parametrize("name", NAMES)
def test_gradient_over_three_seconds_is_bounded(name):
    model = DiffGM3(load_vehicle(name)).double().requires_grad_(False)
    torch.manual_seed(5)
    steer = 0.1 * model.spec.limits.steer_max_rad
    controls = torch.randn(64, 30, 2).double() * torch.tensor([1.0, steer]).double()
    controls.requires_grad_()
    state = torch.zeros(64, 8).double()
    state[:, 2] = torch.linspace(0, 6, 64)
    end = rollout(model, state, controls)[:, -1, :2].sum()
    norms = torch.autograd.grad(end, controls)[0].flatten(1).norm(dim=1)
    assert norms.max() < 200


@pytest.mark.parametrize("name", ["bicycle", "wheelchair", "cart"])
def test_wheel_speed_model_has_exact_gradients(name):
    model = DiffGM3WheelSpeed(load_vehicle(name)).double().requires_grad_(False)
    state = torch.tensor([0, 0, 3, 0.1, 0.2, 0.3, 0.05, 0.0]).double().requires_grad_()
    speed = torch.full((1,), 3.0).double()
    control = model.control_for(state.detach()[None], 0.3 + 0 * speed, 0.05 * speed)[0]
    torch.autograd.gradcheck(model, (state, control.requires_grad_()), rtol=1e-3, atol=1e-3)


@pytest.mark.slow
@pytest.mark.usefixtures("nothing_compiled")
@pytest.mark.parametrize("name", ["bicycle", "wheelchair", "cart"])
def test_step_compiles_whole(name):
    model = DiffGM3(load_vehicle(name)).requires_grad_(False)
    compiled = torch.compile(model, fullgraph=True)
    state, control = (part.float()[:64] for part in wild(64))
    state[:, 2] = state[:, 2].abs().clamp(max=10)
    expected = model(state, control)
    assert torch.allclose(compiled(state, control), expected, rtol=1e-3, atol=1e-3)


@pytest.mark.slow
@pytest.mark.usefixtures("nothing_compiled")
def test_a_rollout_compiles_once():
    model = DiffGM3(load_vehicle("bicycle")).requires_grad_(False)
    graphs = []

    def count(graph, inputs):
        graphs.append(graph)
        return graph.forward

    compiled = torch.compile(model, fullgraph=True, backend=count)
    state, controls = torch.randn(16, 8), 0.1 * torch.randn(16, 30, 2)
    for control in controls.unbind(1):
        state = compiled(state, control)
    assert len(graphs) == 1


@pytest.mark.parametrize("law", [ConsistentBrush(), PaperBrush(), SharpBrush()])
def test_coasting_straight_has_finite_derivatives_with_every_law(law):
    model = DiffGM3(load_vehicle("bicycle"), tire=law).double()
    state = torch.tensor([0.0, 0.0, 4.0, 0.0, 0.0, 0.0, 0.0, 0.0]).double().requires_grad_()
    (slope,) = torch.autograd.grad(model(state, torch.zeros(2).double())[0], state)
    assert torch.isfinite(slope).all()
    assert slope[2] == pytest.approx(0.1, rel=0.01)


def test_the_course_of_a_turn_is_that_of_the_axle_that_does_not_slip():
    model = DiffGM3(load_vehicle("bicycle")).double()
    zero, rate = torch.zeros(()).double(), torch.tensor(1.5).double()
    velocity = torch.tensor([3.0, 0.0]).double()
    state = model.state_on_course(Motion(torch.zeros(2).double(), zero, velocity, rate))
    assert state[2:4].norm() == pytest.approx(3.0)
    # left of the middle, at the distance of the rear axle, and the heading turned back by it
    assert state[3] == pytest.approx(0.45 * 1.5, rel=0.02)
    assert state[4] == pytest.approx(-math.asin(0.45 * 1.5 / 3.0), rel=0.02)
