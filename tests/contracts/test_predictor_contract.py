"""What every predictor of `configs/predictor` promises, found by glob."""

from pathlib import Path

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate

from diffstack_mmv.geometry import motion_in_frame, position_from_frame
from diffstack_mmv.prediction import Predictor, ego_forecast, neighbors_forecast
from diffstack_mmv.types import StackBatch, map_tensors
from tests.prediction.samples import DT_S, at_rest, bicycle, scene

FOLDER = Path(__file__).resolve().parents[2] / "configs"
NAMES = sorted(path.stem for path in (FOLDER / "predictor").glob("*.yaml"))
HORIZON = 30


@pytest.fixture(params=NAMES, scope="module")
def predictor(request):
    torch.manual_seed(0)
    values = [f"+predictor={request.param}", f"+dt_s={DT_S}", f"+horizon_s={HORIZON * DT_S}"]
    with initialize_config_dir(str(FOLDER), version_base=None):
        config = compose(overrides=values)
    return instantiate(config.predictor)(ego_dynamics=bicycle()).eval()


def long_scene(**options):
    return scene(history=41, horizon=HORIZON, **options)


def finite(record):
    return all(bool(torch.isfinite(field).all()) for field in record)


def turned(batch, origin, angle):
    """The scene seen from a frame that was moved and turned."""
    parts = (
        tracks._replace(motion=motion_in_frame(tracks.motion, origin, angle))
        for tracks in batch[:4]
    )
    return StackBatch(*parts, batch.goal, batch.dt_s)


def test_there_are_predictors_to_test():
    assert {"trajectron", "constant_velocity", "kalman", "ctra"} <= set(NAMES)


def test_it_is_a_predictor_of_the_asked_horizon(predictor):
    assert isinstance(predictor, Predictor)
    assert (predictor.horizon_steps, predictor.dt_s) == (HORIZON, DT_S)


@pytest.mark.parametrize(("batch", "neighbors"), [((2,), 3), ((2,), 0), ((), 2), ((2, 2), 1)])
def test_forecast_has_one_entry_for_the_ego_and_each_neighbor(predictor, batch, neighbors):
    forecast = predictor.predict(long_scene(batch=batch, neighbors=neighbors))
    components = forecast.log_weight.shape[-1]
    assert forecast.log_weight.shape == (*batch, 1 + neighbors, components)
    assert forecast.mean.shape == (*batch, 1 + neighbors, components, HORIZON, 2)
    assert forecast.scale_tril.shape == (*batch, 1 + neighbors, components, HORIZON, 2, 2)
    assert ego_forecast(forecast).mean.shape == (*batch, components, HORIZON, 2)
    assert neighbors_forecast(forecast).mean.shape == (*batch, neighbors, components, HORIZON, 2)


def test_forecast_is_a_mixture_of_proper_gaussians(predictor):
    forecast = predictor.predict(long_scene())
    assert torch.allclose(forecast.log_weight.logsumexp(-1), torch.zeros(()), atol=1e-5)
    assert (forecast.scale_tril.diagonal(dim1=-2, dim2=-1) > 0).all()
    assert (forecast.scale_tril[..., 0, 1] == 0).all()


@pytest.mark.parametrize("neighbors", [0, 2])
def test_forecast_and_loss_are_finite_at_rest(predictor, neighbors):
    batch = at_rest(long_scene(neighbors=neighbors))
    assert finite(predictor.predict(batch))
    assert finite([predictor.loss(batch)])


def test_forecast_is_finite_without_any_observation(predictor):
    batch = long_scene()
    nothing = batch._replace(
        **{
            name: getattr(batch, name)._replace(valid=torch.zeros_like(getattr(batch, name).valid))
            for name in ("ego_past", "neighbors_past")
        }
    )
    assert finite(predictor.predict(nothing))
    assert finite([predictor.loss(nothing)])


def test_loss_is_one_number_per_sample(predictor):
    assert predictor.loss(long_scene(batch=(2, 3))).shape == (2, 3)


def test_forecast_and_loss_from_one_pass_are_those_from_two(predictor):
    batch = long_scene()
    forecast, loss = predictor.predict_and_judge(batch)
    assert torch.allclose(loss, predictor.loss(batch))
    for field, expected in zip(forecast, predictor.predict(batch), strict=True):
        assert torch.allclose(field, expected)


def test_a_batch_gives_what_its_samples_give_one_by_one(predictor):
    batch = long_scene(batch=(3,))
    together = predictor.predict(batch)
    for sample in range(3):
        alone = predictor.predict(map_tensors(lambda field, at=sample: field[at], batch))
        for field, expected in zip(together, alone, strict=True):
            assert torch.allclose(field[sample], expected, atol=1e-4, rtol=1e-4)


def test_a_moved_and_turned_scene_gives_the_moved_and_turned_forecast(predictor):
    batch = long_scene()
    origin, angle = torch.tensor([3.0, -2.0]), torch.tensor(0.8)
    straight, seen = predictor.predict(batch), predictor.predict(turned(batch, origin, angle))
    near = straight.mean.abs() < 1e3
    mapped = torch.where(near, position_from_frame(seen.mean, origin, angle), straight.mean)
    assert torch.allclose(mapped, straight.mean, atol=2e-3)
    rotation = torch.stack(
        [torch.stack([angle.cos(), -angle.sin()]), torch.stack([angle.sin(), angle.cos()])]
    )
    covariance = seen.scale_tril @ seen.scale_tril.mT
    expected = straight.scale_tril @ straight.scale_tril.mT
    assert torch.allclose(rotation @ covariance @ rotation.mT, expected, atol=5e-3, rtol=1e-2)


def test_rows_that_are_not_valid_have_no_influence(predictor):
    batch = long_scene()
    hidden = torch.zeros_like(batch.neighbors_past.valid)
    hidden[..., :15] = True
    hidden[:, 1] = True
    clean = batch.neighbors_past._replace(valid=~hidden)

    def spoiled(field):
        mask = hidden[(..., *(None,) * (field.dim() - hidden.dim()))]
        return torch.where(mask, torch.full_like(field, 77.0), field)

    dirty = clean._replace(motion=type(clean.motion)(*(spoiled(field) for field in clean.motion)))
    first = predictor.predict(batch._replace(neighbors_past=clean))
    second = predictor.predict(batch._replace(neighbors_past=dirty))
    for one, other in zip(first, second, strict=True):
        assert torch.allclose(one, other, atol=1e-5)


def test_the_future_does_not_leak_into_the_forecast(predictor):
    if type(predictor).__name__ == "GroundTruth":
        pytest.skip("the true future is what it answers with")
    batch = long_scene()
    other_future = long_scene().ego_future
    first, second = (
        predictor.predict(batch),
        predictor.predict(batch._replace(ego_future=other_future)),
    )
    assert torch.equal(first.mean, second.mean)
