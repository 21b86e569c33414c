"""Ten thousand steps of every vehicle: finite however it is driven, at rest where it rests."""

import math

import pytest
import torch

from diffstack_mmv.types import Motion
from diffstack_mmv.vehicles import config_folder, vehicle_names
from tests.contracts.test_dynamics_contract import build

STEPS = 10_000
CALIBRATED = config_folder() / "vehicle" / "calibrated"
VEHICLES = [*vehicle_names(), *(f"calibrated/{path.stem}" for path in CALIBRATED.glob("*.yaml"))]
REST, FULL, SLALOM, NOISE = range(4)


def started(model):
    """State of four riders: one at rest, the others at 3 m/s."""
    speed = torch.tensor([0.0, 3.0, 3.0, 3.0], dtype=torch.float64)
    still = torch.zeros(4, dtype=torch.float64)
    velocity = torch.stack([speed, still], -1)
    return model.initial_state(Motion(torch.zeros(4, 2).double(), still, velocity, still))


def driven(model, step, generator):
    """Controls of a step: none, the upper bounds, from bound to bound, and at random."""
    lower, upper = (bound.double() for bound in model.bounds)
    wave = 0.5 + 0.5 * math.sin(0.3 * step)
    share = torch.rand(model.control_dim, generator=generator, dtype=torch.float64)
    return torch.stack(
        [0.0 * upper, upper, lower + wave * (upper - lower), lower + share * (upper - lower)]
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["unicycle", "kbm", "gm3"])
@pytest.mark.parametrize("vehicle", VEHICLES)
@torch.no_grad()
def test_a_long_ride_stays_finite_and_a_rest_stays_a_rest(name, vehicle, unchecked):
    model, generator = build(name, vehicle), torch.Generator().manual_seed(0)
    state = start = started(model)
    for step in range(STEPS):
        state = model(state, driven(model, step, generator))
        if step % 1000 == 0:
            assert state.isfinite().all(), f"step {step}"
    assert state.isfinite().all()
    before, after = (model.motion(each, torch.zeros(4, model.control_dim).double())
                     for each in (start, state))  # fmt: skip
    moved = (after.position - before.position)[REST].norm()
    assert moved < 1e-6
    assert after.velocity[REST].norm() < 1e-6
    assert (after.heading - before.heading)[REST].abs() < 1e-6
