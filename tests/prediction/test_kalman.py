"""The Kalman filter with constant velocity."""

import pytest
import torch

from diffstack_mmv.prediction import KalmanConstantVelocity
from diffstack_mmv.prediction.gaussian import covariance_along
from diffstack_mmv.types import Motion
from tests.prediction.samples import DT_S, scene


def test_filter_equals_least_squares_over_all_rows():
    """Without process noise the filter is the posterior of a straight line."""
    kalman = KalmanConstantVelocity(10, DT_S, acceleration_density=1e-12, speed_mps=2.0)
    tracks = scene(batch=(), history=15, dtype=torch.float64).ego_past
    state, covariance = kalman.filtered(tracks)
    time = DT_S * torch.arange(-14, 1, dtype=torch.float64)
    size = torch.ones_like(time)
    noise = covariance_along(tracks.motion.heading, 0.08 * size, 0.05 * size)
    eye, information, vector = (
        torch.eye(2, dtype=torch.float64),
        torch.zeros(4, 4, dtype=torch.float64),
        torch.zeros(4, dtype=torch.float64),
    )
    information[2:, 2:] = eye / 4
    for row in range(15):
        design = torch.cat([eye, time[row] * eye], -1)
        weighted = design.mT @ torch.linalg.inv(noise[row])
        information += weighted @ design
        vector += weighted @ tracks.motion.position[row]
    assert torch.allclose(state, torch.linalg.solve(information, vector), atol=1e-6)
    assert torch.allclose(covariance, torch.linalg.inv(information), atol=1e-8)


def test_missing_rows_widen_the_forecast():
    kalman = KalmanConstantVelocity(10, DT_S)
    tracks = scene(history=21).ego_past
    valid = tracks.valid.clone()
    valid[:, :-3] = False
    full, short = kalman.filtered(tracks)[1], kalman.filtered(tracks._replace(valid=valid))[1]
    assert (short.diagonal(dim1=-2, dim2=-1) > full.diagonal(dim1=-2, dim2=-1)).all()


def test_forecast_covers_the_noise_it_was_told():
    """The normalised squared error of simulated straight tracks has its expected value, 2."""
    kalman = KalmanConstantVelocity(10, DT_S, along_m=0.1, across_m=0.1, acceleration_density=0.2)
    batch = scene(batch=(400,), neighbors=0, history=41)
    kicks = (0.2 * DT_S) ** 0.5 * torch.randn(400, 51, 2)
    velocity = 3 * torch.randn(400, 1, 2) + kicks.cumsum(1)
    position = (DT_S * velocity).cumsum(1)
    zero = torch.zeros(400, 41)
    seen = Motion(
        position[:, :41] + 0.1 * torch.randn(400, 41, 2), zero, torch.zeros(400, 41, 2), zero
    )
    forecast = kalman(batch.ego_past._replace(motion=seen), batch.neighbors_past)
    error = (position[:, 50] - forecast.mean[:, 0, 0, 9]).unsqueeze(-1)
    white = torch.linalg.solve_triangular(forecast.scale_tril[:, 0, 0, 9], error, upper=False)
    assert 1.7 < white.square().sum((-2, -1)).mean() < 2.3


def step_of(dt_s, density):
    """Transition and process noise of position and velocity over a step, from their integrals."""
    eye = torch.eye(2, dtype=torch.float64)
    transition = torch.kron(torch.tensor([[1.0, dt_s], [0.0, 1.0]], dtype=torch.float64), eye)
    # trapezoids over the time at which a kick happens, which then acts for the rest of the step
    left = torch.linspace(0, dt_s, 4001, dtype=torch.float64)
    effect = torch.stack([left, torch.ones_like(left)])
    noise = torch.trapezoid(effect[:, None] * effect[None], left, dim=-1)
    return transition, torch.kron(density * noise, eye)


def smoothed(tracks, density, speed):
    """Posterior of the state at the last row: all rows in one system of equations."""
    seen = tracks.valid.nonzero().flatten().tolist()
    first, rows = seen[0], tracks.valid.shape[-1]
    transition, noise = step_of(DT_S, density)
    size = 4 * (rows - first)
    information = torch.zeros(size, size, dtype=torch.float64)
    vector = torch.zeros(size, dtype=torch.float64)
    information[2:4, 2:4] += torch.eye(2, dtype=torch.float64) / speed**2
    for row in range(first, rows):
        at = 4 * (row - first)
        if row > first:
            change = torch.cat([-transition, torch.eye(4, dtype=torch.float64)], -1)
            information[at - 4 : at + 4, at - 4 : at + 4] += (
                change.mT @ torch.linalg.inv(noise) @ change
            )
        if row in seen:
            cosine, sine = tracks.motion.heading[row].cos(), tracks.motion.heading[row].sin()
            turn = torch.stack([cosine, -sine, sine, cosine]).reshape(2, 2)
            weight = turn @ torch.diag(turn.new_tensor([0.08, 0.05]) ** -2) @ turn.mT
            information[at : at + 2, at : at + 2] += weight
            vector[at : at + 2] += weight @ tracks.motion.position[row]
    covariance = torch.linalg.inv(information)
    return (covariance @ vector)[-4:], covariance[-4:, -4:]


@pytest.mark.parametrize("missing", [(), (0, 1, 2), (4, 5, 9), (0, 3, 11)])
def test_filter_is_the_posterior_of_all_rows_that_were_seen(missing):
    kalman = KalmanConstantVelocity(10, DT_S, acceleration_density=0.7, speed_mps=2.0)
    tracks = scene(batch=(), history=12, dtype=torch.float64).ego_past
    tracks.valid[list(missing)] = False
    state, covariance = kalman.filtered(tracks)
    expected = smoothed(tracks, 0.7, 2.0)
    torch.testing.assert_close(state, expected[0], atol=1e-6, rtol=1e-6)
    torch.testing.assert_close(covariance, expected[1], atol=1e-7, rtol=1e-5)


def test_forecast_repeats_the_step_of_the_process():
    kalman = KalmanConstantVelocity(10, DT_S, acceleration_density=0.7)
    batch = scene(batch=(2,), neighbors=0, history=6, dtype=torch.float64)
    state, covariance = kalman.filtered(batch.ego_past)
    forecast = kalman(batch.ego_past, batch.neighbors_past)
    transition, noise = step_of(DT_S, 0.7)
    for step in range(10):
        state = state @ transition.mT
        covariance = transition @ covariance @ transition.mT + noise
        root = forecast.scale_tril[:, 0, 0, step]
        floor = 4e-4 * torch.eye(2, dtype=torch.float64)
        torch.testing.assert_close(forecast.mean[:, 0, 0, step], state[:, :2])
        torch.testing.assert_close(root @ root.mT, covariance[:, :2, :2] + floor)
