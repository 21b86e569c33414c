"""Lean laws: both reach the lean of a steady turn; the coordinated one does not come late."""

import math

import pytest
import torch

from diffstack_mmv.dynamics.gm3 import (
    LIM2,
    CoordinatedLean,
    DiffGM3,
    PrescribedLean,
    RungeKutta4,
)
from diffstack_mmv.dynamics.gm3.lean import (
    Lean,
    LeanLaw,
    RollBody,
    lean_acceleration,
    lean_after,
)
from diffstack_mmv.dynamics.rollout import rollout
from diffstack_mmv.types import GRAVITY, Motion
from diffstack_mmv.vehicles import load_vehicle

LAWS = [PrescribedLean(), CoordinatedLean()]


def response(law, lateral, step_s):
    """Lean under a lateral acceleration over time."""
    pendulum = law.pendulum(RollBody(90.0, torch.tensor(99.0), torch.tensor(473.0)))
    lean, found = Lean(torch.zeros(1), torch.zeros(1)), []
    for before, after in zip(lateral[:-1], lateral[1:], strict=True):
        push = 0.5 * (before + after) + law.lead_s * (after - before) / step_s
        lean = lean_after(lean, push, pendulum.secant(lean.angle), step_s)
        found.append(float(lean.angle))
    return torch.tensor(found)


@pytest.mark.parametrize("law", LAWS, ids=repr)
def test_steady_lean(law):
    lean = response(law, torch.full((200, 1), 2.0), 0.05)
    assert float(lean[-1]) == pytest.approx(math.atan(2.0 / 9.81), rel=1e-3)


@pytest.mark.parametrize(("law", "late_s"), [(LAWS[0], 0.53), (LAWS[1], -0.1)], ids=repr)
def test_slow_turns_show_the_delay_of_the_law(law, late_s):
    time = 0.02 * torch.arange(3001)
    lateral = 0.2 * torch.sin(0.3 * time).unsqueeze(-1)
    lean = response(law, lateral, 0.02)
    expected = 0.2 / 9.81 * torch.sin(0.3 * (time[1:] - late_s))
    assert float((lean - expected)[1000:].abs().max()) < 0.02 * 0.2 / 9.81


@pytest.mark.parametrize("step_s", [0.01, 0.3])
@pytest.mark.parametrize("law", LAWS, ids=repr)
def test_a_step_is_the_trapezoid_of_the_accelerations_at_its_ends(
    law: LeanLaw, step_s: float
) -> None:
    pendulum = law.pendulum(RollBody(90.0, torch.tensor(99.0), torch.tensor(473.0)))
    before, lateral = Lean(torch.tensor([0.2]), torch.tensor([-0.4])), torch.tensor([1.5])
    frozen = pendulum.secant(before.angle)
    after = lean_after(before, lateral, frozen, step_s)
    ends = [lean_acceleration(each, lateral, frozen) for each in (before, after)]
    torch.testing.assert_close(after.rate - before.rate, step_s * sum(ends) / 2)
    torch.testing.assert_close(after.angle - before.angle, step_s * (before.rate + after.rate) / 2)


@pytest.mark.parametrize("law", LAWS, ids=repr)
@pytest.mark.parametrize("lateral", [-4.0, 0.0, 4.0])
def test_a_vehicle_that_leans_as_its_turn_asks_is_at_rest(law: LeanLaw, lateral: float) -> None:
    pendulum = law.pendulum(RollBody(90.0, torch.tensor(99.0), torch.tensor(473.0)))
    asked = torch.tensor([math.atan(lateral / GRAVITY)])
    turn = torch.tensor([lateral])
    lean = Lean(asked, torch.zeros(1))
    assert lean_acceleration(lean, turn, pendulum.secant(asked)).abs() < 1e-5
    falling = Lean(asked, torch.tensor([0.5]))
    assert lean_acceleration(falling, turn, pendulum.secant(asked)) < -1.0


@pytest.mark.parametrize("bandwidth", [0.0, -8.0])
def test_a_rider_without_a_bandwidth_is_refused(bandwidth: float) -> None:
    with pytest.raises(ValueError, match="`bandwidth_radps` must be positive"):
        CoordinatedLean(bandwidth_radps=bandwidth)


def test_law_is_part_of_the_model():
    spec = load_vehicle("bicycle")
    zero = torch.zeros(1)
    start = Motion(torch.zeros(1, 2), zero, torch.tensor([[4.0, 0.0]]), zero)
    leans = []
    for law in LAWS:
        model = DiffGM3(spec, lean=law)
        states = rollout(model, model.initial_state(start), torch.tensor([[[0.0, 0.1]] * 4]))
        leans.append(states[0, -1, model.State._fields.index("lean")].item())
    assert leans[1] > 2 * leans[0] > 0


@pytest.mark.parametrize("law", LAWS, ids=repr)
def test_a_lean_is_nearly_the_same_by_ever_finer_steps(law: LeanLaw) -> None:
    zero, speed = torch.zeros(1), torch.tensor([[4.0, 0.0]])
    start = Motion(torch.zeros(1, 2), zero, speed, zero)
    controls, leans = torch.tensor([[[0.0, 0.1]] * 5]), []
    for substeps in (1, 8):
        model = DiffGM3(load_vehicle("bicycle"), lean=law, substeps=substeps).requires_grad_(False)
        states = rollout(model, model.initial_state(start), controls)
        leans.append(float(states[0, -1, model.State._fields.index("lean")]))
    assert leans[0] == pytest.approx(leans[1], rel=0.1)


TURNING = torch.tensor([0, 0, 4.0, 0.1, 0.3, 0.4, 0.1, -0.2]).double()


def test_a_prescribed_lean_is_that_of_a_pendulum_of_this_height() -> None:
    spec = load_vehicle("motorcycle")
    model = DiffGM3(spec).double().requires_grad_(False)
    rate = model.derivative(TURNING, torch.tensor([0.8, 0.2]).double())
    known, lean = model.physical_parameters(), TURNING[6]
    turn = TURNING[2] * TURNING[5] * lean.cos() - GRAVITY * lean.sin()
    moment = spec.mass_kg * spec.height_m * turn - known["roll_damping"] * TURNING[7]
    assert spec.height_m < 0.9
    torch.testing.assert_close(known["roll_inertia"] * rate[7], moment)


def test_a_coordinated_lean_answers_what_its_turn_will_be() -> None:
    law = CoordinatedLean()
    model = DiffGM3(load_vehicle("bicycle"), lean=law).double().requires_grad_(False)
    rate = model.derivative(TURNING, torch.tensor([0.8, 0.2]).double())
    change = rate[2] * TURNING[5] + TURNING[2] * rate[5]
    lead = (law.anticipation_s + 2 / law.bandwidth_radps) * change
    lean, omega = TURNING[6], law.bandwidth_radps
    push = lean.cos() * (TURNING[2] * TURNING[5] + lead) / GRAVITY
    torch.testing.assert_close(rate[7], omega**2 * (push - lean.sin()) - 2 * omega * TURNING[7])
    assert float(lead.abs()) > 1.0


def test_a_coordinated_lean_by_small_steps_is_that_of_the_classical_method() -> None:
    straight, control = torch.zeros(8).double(), torch.tensor([0.3, 0.1]).double()
    straight[2], ends = 4.0, []
    for stepper, substeps in ((LIM2(), 6), (RungeKutta4(), 12)):
        model = DiffGM3(load_vehicle("bicycle"), 0.02, None, substeps, stepper, CoordinatedLean())
        ends.append(model.double().requires_grad_(False)(straight, control))
    torch.testing.assert_close(*ends, rtol=0.02, atol=1e-6)
