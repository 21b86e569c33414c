"""What the figures of plans show of a batch."""

from types import SimpleNamespace

import numpy as np
import torch

from diffstack_mmv.callbacks import scenes_of
from diffstack_mmv.types import Forecast, Motion, StackBatch, Tracks


def tracks(count, agents, steps):
    lead = (count,) if agents is None else (count, agents)
    zero = torch.zeros(*lead, steps)
    motion = Motion(zero.unsqueeze(-1).expand(*lead, steps, 2), zero, zero, zero)
    return Tracks(motion, torch.ones(*lead, 2), torch.zeros(lead).long(), zero == 0)


def test_the_prediction_that_is_drawn_is_the_one_that_is_scored():
    """The median, not the heaviest component; components stand beside it."""
    steps = torch.arange(1.0, 4.0).unsqueeze(-1)
    directions = torch.tensor([[1.0, 1.0], [1.0, 0.1], [1.0, 0.0]])
    mean = (directions[:, None] * steps)[None, None]
    scale = torch.eye(2).expand(1, 1, 3, 3, 2, 2)
    forecast = Forecast(torch.tensor([[[0.4, 0.3, 0.3]]]).log(), mean, scale)
    plan = SimpleNamespace(
        motion=SimpleNamespace(position=mean[:, 0, 0]),
        candidates=SimpleNamespace(position=mean[:, 0]),
    )
    output = SimpleNamespace(forecast=forecast, plan=plan, goal=torch.zeros(1, 2))
    sides = [tracks(1, agents, steps) for agents in (None, 2) for steps in (4, 3)]
    batch = StackBatch(*sides, torch.zeros(1, 2), 0.1)
    (scene,) = scenes_of(batch, output, ["one"])
    np.testing.assert_allclose(scene.prediction, forecast.median()[0, 0].numpy())
    assert abs(scene.prediction[-1, 1] - scene.components[0, -1, 1]) > 1  # the heaviest
    assert scene.components.shape == (3, 3, 2)
