"""Lean laws: both reach the lean of a steady turn; the coordinated one does not come late."""

import math

import pytest
import torch

from diffstack_mmv.dynamics.gm3 import CoordinatedLean, DiffGM3, PrescribedLean
from diffstack_mmv.dynamics.gm3.lean import Lean, RollBody, lean_after
from diffstack_mmv.dynamics.rollout import rollout
from diffstack_mmv.types import Motion
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
