"""The Kalman filter with constant velocity."""

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
