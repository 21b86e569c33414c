"""One path out of several estimates."""

import pytest
import torch

from diffstack_mmv.prediction import ConstantVelocity, combined_path, ego_forecast
from tests.prediction.samples import DT_S, at_rest, scene, trajectron

HORIZON = 10


def path_of(forecast, batch):
    return combined_path(forecast.median(), forecast.expected(), batch.ego_past, DT_S)


def test_it_is_median_mean_and_constant_velocity_by_their_shares():
    torch.manual_seed(0)
    batch = scene()
    forecast = ego_forecast(trajectron().eval().predict(batch))
    steady = ego_forecast(ConstantVelocity(HORIZON, DT_S).predict(batch)).most_likely()
    expected = 0.4 * forecast.median() + 0.4 * forecast.expected() + 0.2 * steady
    path = path_of(forecast, batch)
    torch.testing.assert_close(path, expected)


def test_of_constant_velocity_it_is_that_path():
    batch = scene()
    forecast = ego_forecast(ConstantVelocity(HORIZON, DT_S).predict(batch))
    path = path_of(forecast, batch)
    torch.testing.assert_close(path, forecast.most_likely())


@pytest.mark.parametrize("seen", [0, 1])
def test_it_is_finite_for_who_was_hardly_or_never_seen(seen):
    batch = at_rest(scene())
    valid = torch.zeros_like(batch.ego_past.valid)
    valid[..., valid.shape[-1] - seen :] = True
    batch = batch._replace(ego_past=batch.ego_past._replace(valid=valid))
    forecast = ego_forecast(trajectron().eval().predict(batch))
    assert path_of(forecast, batch).isfinite().all()
