"""Derivatives of simulated rides, chained from those of single steps."""

import pytest
import torch
from torch.func import jacfwd

from diffstack_mmv.dynamics.catalogue import model_of
from diffstack_mmv.identification import ParameterVector
from diffstack_mmv.identification.measured import MeasurementNoise, RideSimulator, RideWindows
from diffstack_mmv.identification.measured.rides import chord_course
from diffstack_mmv.identification.measured.simulator import COASTING, POSE, RECORDING
from diffstack_mmv.vehicles import load_vehicle

WINDOWS, STEPS = 2, 7


@pytest.mark.parametrize("dynamics", ["kbm", "gm3", "unicycle"])
@pytest.mark.parametrize("own", [False, True], ids=["one vehicle", "a vehicle each"])
def test_derivatives_are_those_of_the_simulation(dynamics, own):
    spec, generator = load_vehicle("autobike"), torch.Generator().manual_seed(0)

    def some(*shape, scale=0.1):
        return scale * torch.randn(*shape, dtype=torch.float64, generator=generator)

    model = model_of(spec, dynamics, 0.1).double()
    parameters = ParameterVector(model, spec)
    simulator = RideSimulator(model, parameters, MeasurementNoise(), spec)
    position = some(WINDOWS, STEPS + 1, 2).cumsum(1)
    windows = RideWindows(
        torch.arange(WINDOWS), (), position[:, 0], position, chord_course(position),
        torch.ones(WINDOWS, STEPS + 1, dtype=torch.bool),
        some(WINDOWS, STEPS), some(WINDOWS, STEPS),
        3 + some(WINDOWS, STEPS + 1), some(WINDOWS, STEPS), some(WINDOWS, STEPS + 1),
    )  # fmt: skip
    unknowns = POSE + RECORDING + COASTING + 2 * simulator.knots(STEPS)
    local = some(WINDOWS, unknowns, scale=0.05)
    shared = torch.cat([parameters.start(), torch.tensor([0.3, 0.5, 1.0]).double()])
    if own:
        shared = shared + some(WINDOWS, len(shared), scale=0.05)

    def outputs(shared, local):
        found = simulator.simulate(windows, shared, local)
        return torch.cat([found.position.flatten(1), found.yaw_rate], -1)

    found = simulator.linearise(windows, shared, local)
    torch.testing.assert_close(found.outputs, outputs(shared, local))
    by_shared, by_local = jacfwd(outputs, (0, 1))(shared, local)
    if own:
        by_shared = torch.stack([by_shared[one, :, one] for one in range(WINDOWS)])
    by_local = torch.stack([by_local[one, :, one] for one in range(WINDOWS)])
    torch.testing.assert_close(found.shared, by_shared)
    torch.testing.assert_close(found.local, by_local)
    alone = simulator.linearise(windows, shared, local, by_shared=False)
    torch.testing.assert_close(alone.local, by_local)
    assert alone.shared.shape[-1] == 0
