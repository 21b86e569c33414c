"""Residuals of windows: turned into the course, robust, and free of the bias of the gyro."""

import math

import pytest
import torch

from diffstack_mmv.identification.measured import MeasurementNoise, RideWindows
from diffstack_mmv.identification.measured.instruments import Gaussian
from diffstack_mmv.identification.measured.residuals import PLAIN, residuals
from diffstack_mmv.identification.measured.simulator import Linearised

STEPS = 4
NOISE = MeasurementNoise(yaw_rate_bias=Gaussian(0.02, 0.5))


def standing(course=0.0, known=True, yaw_rate=0.0):
    """One window of a vehicle that is recorded at the origin."""

    def full(value, *shape):
        return torch.full((1, *shape), value, dtype=torch.float64)

    zero = full(0.0, STEPS + 1)
    return RideWindows(
        torch.zeros(1, dtype=torch.long), ("one",), full(0.0, 2), full(0.0, STEPS + 1, 2),
        full(course, STEPS + 1), torch.full((1, STEPS + 1), known),
        zero[:, 1:], zero[:, 1:], zero, full(yaw_rate, STEPS), zero,
    )  # fmt: skip


def outputs(place, yaw_rate=0.0):
    """A model that is always at a place, each output its own unknown."""
    positions = torch.tensor([place] * (STEPS + 1), dtype=torch.float64).flatten()
    value = torch.cat([positions, torch.full((STEPS,), yaw_rate, dtype=torch.float64)])
    slopes = torch.eye(len(value), dtype=torch.float64).unsqueeze(0)
    return Linearised(value.unsqueeze(0), slopes, slopes)


def of_positions(place, course=0.0, known=True, robust=PLAIN):
    system = residuals(standing(course, known), outputs(place), NOISE, False, robust)
    return system.residual.unflatten(-1, (-1, 2))[0]


@pytest.mark.parametrize("course", [0.0, 0.7, -2.0])
def test_distances_count_in_the_noise_along_and_across_the_course(course):
    ahead = (0.3 * math.cos(course), 0.3 * math.sin(course))
    along, across = of_positions(ahead, course).unbind(-1)
    torch.testing.assert_close(along, torch.full_like(along, 0.3 / NOISE.along_m))
    assert across.abs().max() < 1e-9


def test_positions_that_are_not_known_count_nothing():
    assert not of_positions((5.0, 5.0), known=False).any()


@pytest.mark.parametrize("deviations", [0.5, 2.9, 3.1, 40.0])
def test_half_the_square_of_a_residual_is_hubers_cost(deviations):
    (along, _), *_ = of_positions((deviations * NOISE.along_m, 0.0), robust=3.0)
    huber = torch.nn.functional.huber_loss(
        torch.tensor(deviations).double(), torch.zeros(()).double(), delta=3.0
    )
    assert 0.5 * along.square().item() == pytest.approx(huber.item())


@pytest.mark.parametrize("robust", [3.0, PLAIN])
@pytest.mark.parametrize("place", [(0.01, -0.02), (0.8, 0.5)])
def test_slopes_are_the_derivatives_of_the_residuals(place, robust):
    windows, at = standing(0.4, yaw_rate=0.1), outputs(place, 0.3)

    def residual(value):
        return residuals(windows, at._replace(outputs=value), NOISE, True, robust).residual

    expected = torch.autograd.functional.jacobian(residual, at.outputs)[0, :, 0]
    system = residuals(windows, at, NOISE, True, robust)
    torch.testing.assert_close(system.local[0], expected)
    torch.testing.assert_close(system.shared[0], expected)


def test_the_bias_of_the_gyro_is_marginalised():
    rates = torch.tensor([0.1, -0.2, 0.3, 0.05], dtype=torch.float64)
    at = outputs((0.0, 0.0))
    at = at._replace(outputs=torch.cat([at.outputs[:, :-STEPS], rates.unsqueeze(0)], 1))
    found = residuals(standing(yaw_rate=NOISE.yaw_rate_bias.mean), at, NOISE, True).residual
    white, bias = NOISE.yaw_rate_radps**2, NOISE.yaw_rate_bias.std**2
    covariance = white * torch.eye(STEPS).double() + bias * torch.ones(STEPS, STEPS).double()
    expected = rates @ torch.linalg.solve(covariance, rates)
    assert found[0, -STEPS:].square().sum().item() == pytest.approx(expected.item())


@pytest.mark.parametrize(("with_gyro", "rows"), [(False, 2 * STEPS + 2), (True, 3 * STEPS + 2)])
def test_the_gyro_has_rows_where_it_is_used(with_gyro, rows):
    system = residuals(standing(), outputs((0.0, 0.0)), NOISE, with_gyro)
    assert system.residual.shape == (1, rows)


def test_a_yaw_rate_that_was_not_recorded_counts_nothing():
    found = residuals(standing(yaw_rate=math.nan), outputs((0.0, 0.0), 9.0), NOISE, True)
    assert not found.residual.any()
    assert not found.local[:, -STEPS:].any()
