"""Pedestrians forecast by a predictor: the right past goes in, and the right future comes out."""

import pytest
import torch

from diffstack_mmv.dynamics import DiffKBM, SingleIntegrator
from diffstack_mmv.geometry import rotate
from diffstack_mmv.prediction import ConstantVelocity, Sizes, Trajectron
from diffstack_mmv.simulation import LearnedForecaster
from diffstack_mmv.simulation.learned_forecaster import last_heading
from diffstack_mmv.types import map_tensors
from diffstack_mmv.vehicles import load_vehicle
from tests.simulation.test_forecasters import paths


class Recorder(ConstantVelocity):
    """Remembers what it was shown."""

    def forward(self, past, neighbors):
        self.past, self.neighbors = past, neighbors
        return super().forward(past, neighbors)


@pytest.fixture
def tiny():
    torch.manual_seed(0)
    bicycle, pedestrian = DiffKBM(load_vehicle("bicycle"), 0.1), SingleIntegrator(0.1)
    sizes = Sizes(history=8, edge=8, future=8, decoder=16)
    return Trajectron(bicycle, bicycle, pedestrian, 30, 3, 2, sizes).eval()


def test_straight_walks_are_continued_at_the_step_of_the_plan(observed, scene_with):
    seen = observed(scene_with((3.0, -5.0), (3.0, 5.0)), 8)
    path = paths(LearnedForecaster(ConstantVelocity(30, 0.1), 1.0), *seen[:5])
    truth = torch.stack([each.pedestrian_position for each in seen[4:9]], -2)
    assert torch.allclose(path, truth, atol=1e-4)


def test_beyond_the_horizon_the_last_velocity_holds_on(observed, scene_with):
    seen = observed(scene_with((3.0, -5.0), (3.0, 5.0)), 4)[-1]
    path = paths(LearnedForecaster(ConstantVelocity(10, 0.1), 1.0), seen, steps=12)
    assert torch.allclose(
        path.diff(dim=-2), 0.25 * seen.pedestrian_velocity[..., None, :], atol=1e-4
    )


def test_the_past_is_the_walk_at_the_step_of_the_predictor(observed, scenario_of):
    seen = observed(scenario_of("circle").cases("test", [0, 1]), 6)
    recorder = Recorder(30, 0.1)
    paths(LearnedForecaster(recorder, 1.0), *seen, steps=2)
    shown = recorder.neighbors
    assert shown.valid.all()
    assert not recorder.past.valid.any()
    for back, each in ((0, seen[-1]), (5, seen[-3]), (10, seen[-5])):
        position = shown.motion.position[..., -1 - back, :]
        assert torch.allclose(position, each.pedestrian_position.float(), atol=1e-5)


def test_rows_before_the_start_are_not_valid(observed, scenario_of):
    seen = observed(scenario_of("circle").cases("test", [0]), 2)
    recorder = Recorder(30, 0.1)
    paths(LearnedForecaster(recorder, 1.0), *seen, steps=2)
    assert recorder.neighbors.valid[0, 0].tolist() == [False] * 5 + [True] * 6


def test_a_batch_is_forecast_as_its_episodes_one_by_one(observed, scenario_of, tiny):
    seen = observed(scenario_of("circle").cases("test", range(3)), 4)
    single = [map_tensors(lambda entry: entry[1:2], each) for each in seen]
    path = paths(LearnedForecaster(tiny, 1.0), *seen, steps=8)
    assert path.shape == (3, 5, 9, 2)
    alone = paths(LearnedForecaster(tiny, 1.0), *single, steps=8)
    assert torch.allclose(path[1:2], alone, atol=1e-5)


@pytest.mark.parametrize(("components", "kept"), [(1, 1), (2, 2), (9, 3)])
def test_the_likeliest_components_are_kept(observed, scenario_of, tiny, components, kept):
    seen = observed(scenario_of("circle").cases("test", [0, 1]), 2)[-1]
    forecaster = LearnedForecaster(tiny, 1.0, components)
    forecast, _ = forecaster(forecaster.init(seen), seen, 0.25, 8)
    assert forecast.log_weight.shape == (2, 5, kept)
    assert torch.allclose(forecast.log_weight.exp().sum(-1), torch.ones(2, 5).double())
    assert (forecast.scale_tril.diagonal(dim1=-2, dim2=-1) > 0).all()


def test_nobody_is_taken_to_stay_by_a_predictor_of_egos(observed, scenario_of):
    """A predictor of a benchmark in which everybody is an ego once says nothing of neighbors."""
    torch.manual_seed(0)
    walk, sizes = SingleIntegrator(0.4), Sizes(history=8, edge=8, future=8, decoder=16)
    model = Trajectron(walk, walk, walk, 12, 3, 0, sizes).eval()
    seen = observed(scenario_of("circle").cases("test", range(3)), 12)
    path = paths(LearnedForecaster(model, 2.8), *seen, steps=12)
    moved = (path[..., -1, :] - path[..., 0, :]).norm(dim=-1)
    assert (moved > 1.0).all()
    single = [map_tensors(lambda entry: entry[1:2], each) for each in seen]
    alone = paths(LearnedForecaster(model, 2.8), *single, steps=12)
    assert torch.allclose(path[1:2], alone, atol=1e-5)


def test_a_velocity_is_the_mean_over_a_longer_step_of_the_predictor(observed, scenario_of):
    seen = observed(scenario_of("circle").cases("test", [0]), 8)
    recorder = Recorder(12, 0.4)
    paths(LearnedForecaster(recorder, 1.2), *seen, steps=2)
    motion = recorder.neighbors.motion
    assert recorder.neighbors.valid.all()
    velocity = rotate(motion.velocity, motion.heading)[..., 1:, :]
    assert torch.allclose(velocity, motion.position.diff(dim=-2) / 0.4, atol=1e-5)
    # somebody turned or sped up meanwhile, otherwise that says nothing
    last = seen[-1].pedestrian_velocity.float()
    assert (velocity[..., -1, :] - last).abs().max() > 0.01


def test_without_a_row_before_the_observed_velocity_holds(observed, scenario_of):
    seen = observed(scenario_of("circle").cases("test", [0]), 1)
    recorder = Recorder(12, 0.4)
    paths(LearnedForecaster(recorder, 1.2), *seen, steps=2)
    motion = recorder.neighbors.motion
    assert recorder.neighbors.valid[0, 0].tolist() == [False] * 3 + [True]
    velocity = rotate(motion.velocity, motion.heading)[..., -1, :]
    assert torch.allclose(velocity, seen[-1].pedestrian_velocity.float(), atol=1e-5)


def test_a_loss_on_the_forecast_reaches_the_predictor(observed, scenario_of, tiny):
    seen = observed(scenario_of("circle").cases("test", [0]), 2)[-1]
    paths(LearnedForecaster(tiny, 1.0), seen, steps=8).square().sum().backward()
    gradients = [each.grad for each in tiny.parameters() if each.grad is not None]
    assert all(bool(each.isfinite().all()) for each in gradients)
    assert max(float(each.abs().max()) for each in gradients) > 0


def test_a_heading_stays_at_rest_and_taken_from_the_first_motion_before():
    velocity = torch.tensor([[0.0, 0.0], [0.0, 1.0], [0.0, 0.0], [-1.0, 0.0]])
    heading = last_heading(velocity, torch.ones(4, dtype=torch.bool))
    assert torch.allclose(heading, torch.pi * torch.tensor([0.5, 0.5, 0.5, 1.0]))


@pytest.mark.parametrize("history_s", [0.0, 0.25])
def test_a_past_that_does_not_fit_is_refused(history_s):
    with pytest.raises(ValueError, match="history_s"):
        LearnedForecaster(ConstantVelocity(30, 0.1), history_s)
