"""Forecasts and truths that the tests of the scores share."""

import torch

from diffstack_mmv.types import Forecast, Mode, Motion, Tracks


def tracks(position, valid):
    """Bicycles at positions in m."""
    batch, steps = valid.shape
    zero = torch.zeros(batch, steps)
    motion = Motion(position, zero, torch.zeros(batch, steps, 2), zero)
    return Tracks(motion, torch.ones(batch, 2), torch.full((batch,), int(Mode.BICYCLE)), valid)


def sample(batch=6, components=4, steps=5):
    """A random forecast, and a truth with gaps: none in row 0, nothing valid in row 1, no end in 2.

    Where the truth is not valid, NaN stands in its place.
    """
    scale = 0.5 * torch.eye(2).expand(batch, components, steps, 2, 2)
    weight = torch.randn(batch, components).log_softmax(-1)
    forecast = Forecast(weight, torch.randn(batch, components, steps, 2), scale)
    valid = torch.rand(batch, steps) < 0.7
    valid[0], valid[1], valid[2, :-1], valid[2, -1] = True, False, True, False
    position = torch.randn(batch, steps, 2).masked_fill(~valid.unsqueeze(-1), torch.nan)
    return forecast, tracks(position, valid)


def synced(first, second):
    """The metric of one process, which computes together with the one of another process."""

    def gathered(state, group):
        name = next(name for name in first._defaults if getattr(first, name) is state)
        return [state, getattr(second, name)]

    first.dist_sync_fn, first.distributed_available_fn = gathered, lambda: True
    return first
