"""Derivatives of simulated rides, chained from those of single steps."""

import math

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


@pytest.mark.parametrize("dynamics", ["kbm", "unicycle"])
def test_the_way_of_the_antenna_is_that_of_a_vehicle_in_continuous_time(dynamics):
    """A circle: the error falls with the square of the step, wherever the antenna is."""
    spec, length_s, speed_mps, steer, ahead_m = load_vehicle("autobike"), 2.0, 3.0, 0.2, 0.4
    radius_m = spec.wheelbase.entries()[0][0] / math.tan(steer)

    def error_m(steps: int) -> float:
        model = model_of(spec, dynamics, length_s / steps).double()
        parameters = ParameterVector(model, spec)
        simulator = RideSimulator(model, parameters, MeasurementNoise(), spec)
        ends = torch.zeros(1, steps + 1, dtype=torch.float64)
        means = ends[:, 1:]
        windows = RideWindows(
            torch.zeros(1), (), ends[:, :2], ends.unsqueeze(-1).expand(-1, -1, 2), ends, ends > -1,
            means + steer, means, ends + speed_mps, means, ends,
        )  # fmt: skip
        local = torch.zeros(1, POSE + RECORDING + COASTING + 2 * simulator.knots(steps)).double()
        local[:, POSE + 1] = local[:, POSE + 2] = 1  # scales of steering and speed
        local[:, POSE + RECORDING] = -10  # the wheel is not outrun
        shared = torch.cat([parameters.start(), torch.tensor([ahead_m, 0.0, 1.0]).double()])
        way = simulator.simulate(windows, shared, local).position[0]
        course = speed_mps / radius_m * torch.linspace(0, length_s, steps + 1).double()
        x = radius_m * course.sin() + ahead_m * course.cos()
        y = ahead_m * course.sin() - radius_m * course.cos()
        true = torch.stack([x, y], -1)
        return float((way - way[:1] - true + true[:1]).norm(dim=-1).max())

    assert error_m(20) < 0.01
    assert error_m(40) < 0.3 * error_m(20) + 1e-9


def test_steering_that_is_measured_late_is_ahead_of_what_is_measured():
    spec, rate, late_s = load_vehicle("autobike"), 0.3, 0.05
    model = model_of(spec, "kbm", 0.1).double()
    simulator = RideSimulator(model, ParameterVector(model, spec), MeasurementNoise(), spec)
    ends = torch.zeros(1, STEPS + 1, dtype=torch.float64)
    measured = rate * 0.1 * torch.arange(STEPS).double().unsqueeze(0)
    windows = RideWindows(
        torch.zeros(1), (), ends[:, :2], ends.unsqueeze(-1).expand(-1, -1, 2), ends, ends > -1,
        measured, 0 * measured + rate, ends + 3, 0 * measured, ends,
    )  # fmt: skip
    local = torch.zeros(1, POSE + RECORDING + COASTING + 2 * simulator.knots(STEPS)).double()
    local[:, POSE + 1 : POSE + RECORDING] = torch.tensor([1.0, 1.0, late_s])  # scales, delay
    shared = torch.cat([simulator.parameters.start(), torch.tensor([0.0, 0.0, 1.0]).double()])
    steer = simulator.simulate(windows, shared, local).steer
    torch.testing.assert_close(steer, measured + rate * late_s)
