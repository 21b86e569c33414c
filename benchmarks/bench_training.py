"""What one training step costs, part by part: prediction, candidates, solver, backward.

Every part runs in the same process on the same 64 samples; read the shares, not the seconds.
"""

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from omegaconf import OmegaConf, open_dict

from diffstack_mmv.types import StackBatch
from diffstack_mmv.vehicles import config_folder
from tests.stack.test_module import straight_tracks

SAMPLES, PAST, FUTURE = 64, 41, 30


def stack(dynamics):
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        arguments = [f"dynamics={dynamics}", "data.cache=none", "out=none"]
        config = compose("train", arguments, return_hydra_config=True)
    HydraConfig.instance().set_config(config)
    with open_dict(config):
        config.pop("hydra")
    OmegaConf.resolve(config)
    return instantiate(config.stack)


def batch(neighbors):
    torch.manual_seed(0)
    velocity = torch.randn(SAMPLES, 2) * 0.3 + torch.tensor([4.0, 0.0])
    origin = torch.zeros(SAMPLES, 2)
    around = torch.randn(SAMPLES, neighbors, 2) * 8
    walking = torch.randn(SAMPLES, neighbors, 2)
    future = straight_tracks(origin, velocity, FUTURE, 0)
    return StackBatch(
        straight_tracks(origin, velocity, PAST, PAST),
        future,
        straight_tracks(around, walking, PAST, PAST),
        straight_tracks(around, walking, FUTURE, 0),
        future.motion.position[:, -1],
        0.1,
    )


@pytest.fixture(params=["unicycle", "kbm"])
def made(request):
    torch.set_num_threads(1)
    return stack(request.param)


@pytest.fixture(params=[0, 8], ids=["alone", "8 neighbors"])
def samples(request):
    return batch(request.param)


def test_prediction_forward(benchmark, made, samples):
    benchmark.pedantic(lambda: made.predictor.predict_and_judge(samples), rounds=3, warmup_rounds=1)


def test_candidates_and_their_scores(benchmark, made, samples):
    problem = made(samples).problem
    planner = made.planner
    benchmark.pedantic(
        lambda: planner.candidates(planner.dynamics, problem, FUTURE), rounds=3, warmup_rounds=1
    )


def test_planning_forward(benchmark, made, samples):
    problem = made(samples).problem
    benchmark.pedantic(lambda: made.planner(problem), rounds=3, warmup_rounds=1)


def test_backward_of_all_losses(benchmark, made, samples):
    def prepared():
        forecast, judged = made.predictor.predict_and_judge(samples)
        losses = made.planning_losses(samples, made.plan(samples, forecast))
        return (judged.mean() + sum(value.mean() for value in losses.values()),), {}

    benchmark.pedantic(lambda loss: loss.backward(), setup=prepared, rounds=3, warmup_rounds=1)
