"""An ensemble is the mixture of its members."""

import math

import pytest
import torch

from diffstack_mmv.prediction import ConstantVelocity, Ensemble, KalmanConstantVelocity, Predictor
from diffstack_mmv.types import Forecast
from tests.prediction.samples import scene, trajectron

HORIZON = 10


def members():
    torch.manual_seed(0)
    return [trajectron().eval(), ConstantVelocity(HORIZON, 0.1)]


def test_its_density_is_the_mean_of_the_densities():
    built, batch = members(), scene()
    position = batch.ego_future.motion.position.unsqueeze(1)
    expected = torch.stack([each.predict(batch).log_prob(position) for each in built])
    mixed = Ensemble(built).eval().predict(batch).log_prob(position)
    torch.testing.assert_close(mixed, expected.logsumexp(0) - math.log(2))


def test_weights_sum_to_one_and_tracks_alone_give_the_same():
    ensemble, batch = Ensemble(members()).eval(), scene()
    forecast = ensemble.predict(batch)
    torch.testing.assert_close(forecast.log_weight.logsumexp(-1), torch.zeros(3, 3))
    again = ensemble(batch.ego_past, batch.neighbors_past)
    for one, other in zip(forecast, again, strict=True):
        torch.testing.assert_close(one, other)


def test_of_one_member_it_is_that_member():
    built, batch = members()[0], scene()
    for one, other in zip(Ensemble([built]).predict(batch), built.predict(batch), strict=True):
        torch.testing.assert_close(one, other)


def test_it_forecasts_neighbors_if_every_member_does():
    ignorant = trajectron(neighbor_components=0)
    assert Ensemble([trajectron()]).forecast_neighbors
    assert not Ensemble([trajectron(), ignorant]).forecast_neighbors


def test_every_member_has_its_kernels_compiled():
    class Remembers(Predictor):
        def forward(self, past, neighbors) -> Forecast:
            raise NotImplementedError

        def compile_kernels(self, moments):
            self.told = moments

    built = [Remembers(), Remembers()]
    Ensemble(built).compile_kernels(len)
    assert [each.told for each in built] == [len, len]


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ([], "`members` must hold at least one predictor"),
        (
            [ConstantVelocity(10, 0.1), KalmanConstantVelocity(30, 0.1)],
            r"`members` must have one horizon and step, but got \[\(10, 0.1\), \(30, 0.1\)\]",
        ),
    ],
)
def test_members_that_do_not_fit_are_refused(given, told):
    with pytest.raises(ValueError, match=told):
        Ensemble(given)
