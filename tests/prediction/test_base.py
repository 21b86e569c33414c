"""The interface of predictors and views on forecasts."""

import pytest
import torch

from diffstack_mmv.prediction import (
    ConstantVelocity,
    NoPrediction,
    all_agents,
    ego_forecast,
    forecasts_of,
    neighbors_forecast,
    strongest,
)
from diffstack_mmv.prediction.base import present_agents
from diffstack_mmv.types import Forecast, map_tensors
from tests.prediction.samples import DT_S, scene, trajectron


def mixture(components=4):
    weight = torch.tensor([0.1, 0.5, 0.05, 0.35])[:components].log()
    mean = torch.arange(components).float()[:, None, None].expand(components, 3, 2)
    return Forecast(weight, mean, torch.eye(2).expand(components, 3, 2, 2))


def together(tracks):
    """The same agents within a few metres of each other."""
    near = tracks.motion._replace(position=0.1 * tracks.motion.position)
    return tracks._replace(motion=near)


def test_strongest_keeps_the_heaviest_components_and_normalises():
    kept = strongest(mixture(), 2)
    assert torch.allclose(kept.log_weight.exp(), torch.tensor([0.5, 0.35]) / 0.85)
    assert kept.mean[:, 0, 0].tolist() == [1.0, 3.0]
    assert kept.scale_tril.shape == (2, 3, 2, 2)


def test_strongest_accepts_more_components_than_there_are():
    assert strongest(mixture(), 9).mean.shape == (4, 3, 2)


def test_strongest_needs_a_component():
    with pytest.raises(ValueError, match="`components` must be at least 1, but got 0"):
        strongest(mixture(), 0)


def test_ego_comes_first():
    batch = scene(batch=(2,), neighbors=3)
    agents = all_agents(batch.ego_past, batch.neighbors_past)
    assert torch.equal(agents.motion.position[:, 0], batch.ego_past.motion.position)
    assert torch.equal(agents.valid[:, 1:], batch.neighbors_past.valid)


def test_who_is_not_seen_now_is_not_present_and_not_judged():
    batch = scene(batch=(2,), neighbors=3)
    valid = batch.neighbors_past.valid.clone()
    valid[0, 1, -1], valid[1, 2, :-1] = False, False
    gone = batch._replace(neighbors_past=batch.neighbors_past._replace(valid=valid))
    assert present_agents(gone).tolist() == [[True, True, False, True], [True] * 4]
    predictor = ConstantVelocity(10, DT_S)
    future = batch.neighbors_future.motion.position.clone()
    future[0, 1] = 1e5
    motion = batch.neighbors_future.motion._replace(position=future)
    moved = gone._replace(neighbors_future=batch.neighbors_future._replace(motion=motion))
    assert torch.equal(predictor.loss(moved), predictor.loss(gone))


@pytest.mark.parametrize("steps", [0, 2.5])
def test_a_horizon_without_whole_steps_is_refused(steps, unchecked):
    with pytest.raises(ValueError, match="`horizon_steps` must be"):
        ConstantVelocity(steps, DT_S)
    assert ConstantVelocity(1, DT_S).predict(scene()).mean.shape[-2] == 1


def test_ego_and_others_together_are_the_forecast():
    forecast = ConstantVelocity(10, DT_S).predict(scene(neighbors=2))
    ego, neighbors = ego_forecast(forecast), neighbors_forecast(forecast)
    for whole, first, rest in zip(forecast, ego, neighbors, strict=True):
        assert torch.equal(whole, torch.cat([first.unsqueeze(1), rest], 1))


def test_agents_without_an_ego_are_its_neighbors_where_neighbors_are_forecast():
    batch, model = scene(batch=(2,), neighbors=3), trajectron().eval()
    ego, agents = together(batch.ego_past), together(batch.neighbors_past)
    unseen = ego._replace(valid=torch.zeros_like(ego.valid))
    alone, beside = (neighbors_forecast(model(each, agents)).mean for each in (unseen, ego))
    told = forecasts_of(model, agents).mean
    assert torch.allclose(told, alone, atol=1e-5)
    assert not torch.allclose(told, beside, atol=1e-3)  # an ego is seen by the others


@pytest.mark.parametrize("count", [1, 3])
def test_each_agent_is_the_ego_once_where_only_egos_are_forecast(count):
    model = trajectron(neighbor_components=0).eval()
    agents = together(scene(batch=(2,), neighbors=count).neighbors_past)
    told = forecasts_of(model, agents)
    assert told.mean.shape[:2] == (2, count)
    for one in range(count):
        others = [each for each in range(count) if each != one]
        ego = map_tensors(lambda entry, one=one: entry[:, one], agents)
        rest = map_tensors(lambda entry, others=others: entry[:, others], agents)
        expected = ego_forecast(model(ego, rest))
        assert torch.allclose(told.mean[:, one], expected.mean, atol=1e-5)
        assert torch.allclose(told.log_weight[:, one], expected.log_weight, atol=1e-5)


def test_rows_of_ego_and_others_have_to_agree():
    with pytest.raises(
        ValueError, match="`neighbors` must have 21 rows as the ego has, but got 15"
    ):
        all_agents(scene(history=21).ego_past, scene(history=15).neighbors_past)


def test_loss_is_the_mean_over_agents_and_times_that_were_seen():
    batch = scene(neighbors=1)
    valid = batch.neighbors_future.valid.clone()
    valid[..., 5:] = False
    batch = batch._replace(neighbors_future=batch.neighbors_future._replace(valid=valid))
    predictor = ConstantVelocity(10, DT_S)
    forecast = predictor.predict(batch)
    ego = ego_forecast(forecast).log_prob(batch.ego_future.motion.position).sum(-1)
    other = (
        neighbors_forecast(forecast)
        .log_prob(batch.neighbors_future.motion.position)[..., :5]
        .sum((-2, -1))
    )
    assert torch.allclose(predictor.loss(batch), -(ego + other) / 15, rtol=1e-5)


def test_what_was_not_recorded_does_not_reach_the_gradient_of_a_loss():
    class Learned(ConstantVelocity):
        """Learns how fast everybody is."""

        def __init__(self):
            super().__init__(10, DT_S)
            self.share = torch.nn.Parameter(torch.ones(()))

        def positions(self, tracks, time):
            return self.share * super().positions(tracks, time)

    batch = scene(neighbors=1)
    future = batch.ego_future
    valid = future.valid.clone()
    valid[..., 5:] = False
    position = torch.where(valid.unsqueeze(-1), future.motion.position, torch.nan)
    slopes = []
    for each in (position, position.nan_to_num(7.0)):
        motion = future.motion._replace(position=each)
        predictor = Learned()
        given = batch._replace(ego_future=future._replace(motion=motion, valid=valid))
        predictor.loss(given).sum().backward()
        slopes.append(predictor.share.grad)
    assert torch.isfinite(slopes[0])
    assert torch.equal(*slopes)


@pytest.mark.parametrize("make", [trajectron, lambda **_: ConstantVelocity(10, DT_S)])
@pytest.mark.parametrize(
    ("horizon", "dt_s", "told"),
    [
        (9, DT_S, "`batch.ego_future` must have 10 rows, the steps that are predicted, but got 9"),
        (12, DT_S, "`batch.ego_future` must have 10 rows"),
        (10, 2 * DT_S, f"`batch.dt_s` must be {DT_S:g} s as of the predictor, but got {2 * DT_S}"),
    ],
)
def test_samples_of_another_horizon_or_step_are_not_judged(make, horizon, dt_s, told):
    """A library reads as many numbers as it expects, and not one more or less."""
    predictor, batch = make(neighbor_components=2), scene(horizon=horizon)._replace(dt_s=dt_s)
    predictor.compile_kernels(lambda *_: None)
    with pytest.raises(ValueError, match=told):
        predictor.predict_and_judge(batch)


def test_loss_without_prediction_judges_the_ego_alone():
    batch = scene(neighbors=2)
    alone = scene(neighbors=0)._replace(ego_past=batch.ego_past, ego_future=batch.ego_future)
    assert torch.allclose(
        NoPrediction(10, DT_S).loss(batch), ConstantVelocity(10, DT_S).loss(alone)
    )


@pytest.mark.parametrize(
    ("options", "argument"), [((0, 0.1), "horizon_steps"), ((10, 0.0), "dt_s")]
)
def test_impossible_horizon_is_refused(options, argument):
    with pytest.raises(ValueError, match=f"`{argument}` must"):
        ConstantVelocity(*options)


@pytest.mark.parametrize("predictor", [ConstantVelocity(10, DT_S), trajectron()])
def test_nobody_has_an_empty_forecast(predictor):
    nobody = scene(batch=(2,), neighbors=0).neighbors_past
    assert forecasts_of(predictor, nobody).mean.shape[:2] == (2, 0)


def test_times_are_as_exact_as_the_tracks():
    batch = scene(batch=(2,), neighbors=0, dtype=torch.float64)
    still = batch.ego_past._replace(
        motion=map_tensors(torch.zeros_like, batch.ego_past.motion),
        valid=torch.ones_like(batch.ego_past.valid),
    )
    time = DT_S * torch.arange(1 - still.valid.shape[-1], 1, dtype=torch.float64)
    position = still.motion.position.clone()
    position[..., 0] = 3.0 * time
    tracks = still._replace(motion=still.motion._replace(position=position))
    path = ConstantVelocity(10, DT_S)(tracks, batch.neighbors_past).mean[:, 0, 0, :, 0]
    expected = 3.0 * DT_S * torch.arange(1, 11, dtype=torch.float64)
    assert torch.allclose(path, expected.expand_as(path), atol=1e-12)
